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
    ],
)
def test_dangerous_calls_are_in_the_table(name: str) -> None:
    assert name in seccomp.DENIED


def test_no_call_is_listed_twice() -> None:
    assert len(set(seccomp.DENIED)) == len(seccomp.DENIED)


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
