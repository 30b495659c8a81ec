import builtins
from typing import Any

import pytest
from vitac.evaluator.agent.isolation import seccomp
from vitac.evaluator.agent.verdicts import SandboxFailed

INSTRUCTION_BYTES = 8


def test_filter_is_a_bpf_program() -> None:
    program = seccomp.filter_program()
    assert len(program) % INSTRUCTION_BYTES == 0
    assert len(program) // INSTRUCTION_BYTES > 100


@pytest.mark.parametrize(
    "name",
    [
        "ptrace",
        "process_vm_writev",
        "bpf",
        "io_uring_setup",
        "keyctl",
        "mount",
        "unshare",
        "setns",
        "memfd_create",
        "shmget",
        "landlock_restrict_self",
        "seccomp",
        "sync",
        "syncfs",
        "sysinfo",
        "getrusage",
        "setsockopt",
        "utimensat",
        "clone3",
        "openat2",
    ],
)
def test_calls_that_reach_the_kernel_or_the_next_episode_are_not_allowed(name: str) -> None:
    assert name not in seccomp.ALLOWED


def test_no_call_is_listed_twice() -> None:
    assert len(set(seccomp.ALLOWED)) == len(seccomp.ALLOWED)


def test_every_allowed_call_is_known_to_the_library() -> None:
    """A misspelt name would be left out of the filter in silence."""
    import pyseccomp  # type: ignore[import-untyped]

    newer_than_some_libraries = {"fchmodat2", "epoll_pwait2", "faccessat2", "close_range"}
    unknown = {name for name in seccomp.ALLOWED if pyseccomp.resolve_syscall(pyseccomp.Arch.X86_64, name) == -1}
    assert unknown <= newer_than_some_libraries


def test_missing_library_is_a_clear_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    plain_import = builtins.__import__

    def without_seccomp(name: str, *arguments: Any, **options: Any) -> Any:
        if name == "pyseccomp":
            raise RuntimeError("Unable to find libseccomp")
        return plain_import(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without_seccomp)
    seccomp.filter_program.cache_clear()
    with pytest.raises(SandboxFailed, match="libseccomp2"):
        seccomp.filter_program()
