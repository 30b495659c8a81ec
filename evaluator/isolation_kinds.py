"""What can stand between a policy and the machine: a stage or a worker names it, the sandbox does it."""

from enum import StrEnum


class IsolationKind(StrEnum):
    """What stands between policies and the machine."""

    NAMESPACES = "namespaces"
    """bubblewrap and seccomp on the machine's kernel."""
    VM = "vm"
    """A kernel of its own in each episode."""
    NONE = "none"
    """Nothing: for one's own policy, on a machine that cannot isolate; a service takes none such."""
