"""How the commands that run one's own policy go on where this machine cannot isolate it."""

import os
import sys


def fall_back_where_nothing_isolates() -> None:
    """Let policies run without a sandbox where there can be none, and say so; a service's worker never does."""
    from vitac.evaluator.agent.isolation.machine import explain_no_namespaces
    from vitac.evaluator.agent.session import ISOLATION_VARIABLE
    from vitac.evaluator.isolation_kinds import IsolationKind

    if os.environ.get(ISOLATION_VARIABLE):
        return
    reason = "it needs Linux" if sys.platform != "linux" else explain_no_namespaces()
    if reason:
        os.environ[ISOLATION_VARIABLE] = IsolationKind.NONE
        print(
            "Your policy runs without the sandbox, with the same result but for its limits of memory and processes: "
            f"{reason.rstrip('.')}.",
            file=sys.stderr,
        )
