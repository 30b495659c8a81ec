import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation.process_ids import ProcessIds
from worker_fakes import eventually

TELLS_ITS_CHILDRENS_IDS = """while read -r line; do sh -c 'echo "$$"'; done"""


@pytest.fixture
def namespace() -> Iterator["subprocess.Popen[bytes]"]:
    """A process outside, whose child is the first one of a pid namespace and starts a process for each line."""
    command = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child"]
    with subprocess.Popen(
        [*command, "sh", "-c", TELLS_ITS_CHILDRENS_IDS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as outside:
        yield outside
        outside.kill()


def first_pid(outside: "subprocess.Popen[bytes]") -> int:
    children = Path(f"/proc/{outside.pid}/task/{outside.pid}/children")
    deadline = time.monotonic() + 60
    while not children.read_text():
        if outside.poll() is not None or time.monotonic() > deadline:
            pytest.skip("This machine does not let this user make pid namespaces.")
    first = int(children.read_text())
    eventually(lambda: Path(f"/proc/{first}/uid_map").read_text() != "")  # before, nobody has rights in there
    return first


def next_id(outside: "subprocess.Popen[bytes]") -> int:
    assert outside.stdin is not None
    assert outside.stdout is not None
    outside.stdin.write(b"\n")
    return int(outside.stdout.readline())


def test_processes_are_numbered_from_the_same_id_again_and_again(namespace: "subprocess.Popen[bytes]") -> None:
    with ProcessIds(first_pid(namespace)) as counter:
        assert next_id(namespace) < 500
        for _ in range(3):
            assert counter.continue_after(500)
            assert next_id(namespace) == 501


def test_a_namespace_that_has_ended_is_told(namespace: "subprocess.Popen[bytes]") -> None:
    first = first_pid(namespace)
    with ProcessIds(first) as counter:
        assert counter.continue_after(500)
        namespace.kill()
        namespace.wait()
        eventually(lambda: not Path(f"/proc/{first}").exists())
        assert not counter.continue_after(500)
        assert not counter.continue_after(500)


def test_without_the_program_ids_are_said_not_to_repeat(
    namespace: "subprocess.Popen[bytes]", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with ProcessIds(first_pid(namespace)) as counter:
        assert not counter.continue_after(500)
