import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import process_tree
from vitac.evaluator.agent.isolation.process_tree import ProcessIds
from worker_fakes import eventually

SPINS_WITH_A_CHILD = "import os, time\nif os.fork() == 0:\n    time.sleep(60)\nprint(flush=True)\nwhile True: pass"


@pytest.fixture
def parent() -> Iterator[int]:
    with subprocess.Popen([sys.executable, "-c", SPINS_WITH_A_CHILD], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process.pid
        process_tree.kill_descendants(process.pid)
        process.kill()


def test_finds_children(parent: int) -> None:
    assert len(list(process_tree.descendants(parent))) == 1
    assert parent in process_tree.descendants(os.getpid())


def test_reads_a_file_of_any_length_and_of_any_bytes(tmp_path: Path) -> None:
    (tmp_path / "long").write_bytes(b"x" * 200_001 + b"\xff")
    assert process_tree.read_text_file(str(tmp_path / "long")) == "x" * 200_001 + "\N{REPLACEMENT CHARACTER}"
    (tmp_path / "empty").touch()
    assert process_tree.read_text_file(str(tmp_path / "empty")) == ""
    with pytest.raises(FileNotFoundError):
        process_tree.read_text_file("/proc/4194305/status")
    still_open = {Path(os.path.realpath(link)) for link in Path("/proc/self/fd").iterdir()}
    assert not still_open & {path.resolve() for path in tmp_path.iterdir()}


def test_reads_time_and_memory(parent: int) -> None:
    first = process_tree.cpu_s(parent)
    while process_tree.cpu_s(parent) == first:
        pass
    assert process_tree.cpu_s(parent) > first
    assert process_tree.resident_bytes(parent) > 1_000_000


BURNS_IN_A_CHILD = """
import os, time
if os.fork() == 0:
    while time.process_time() < 0.3: pass
    os._exit(0)
os.wait()
print(flush=True)
time.sleep(60)
"""


def test_time_of_children_that_were_waited_for_is_their_parents() -> None:
    with subprocess.Popen([sys.executable, "-c", BURNS_IN_A_CHILD], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert process_tree.reaped_cpu_s(process.pid) >= 0.28
        process.kill()
    assert process_tree.reaped_cpu_s(process.pid) == 0


def test_pid_outside_any_namespace_is_the_same(parent: int) -> None:
    assert process_tree.inside_pid(parent) == parent


def test_ended_processes_use_nothing() -> None:
    process = subprocess.Popen(["true"])
    process.wait()
    assert process_tree.cpu_s(process.pid) == 0
    assert process_tree.resident_bytes(process.pid) == 0
    assert list(process_tree.descendants(process.pid)) == []
    with pytest.raises(ProcessLookupError):
        process_tree.inside_pid(process.pid)
    process_tree.kill_descendants(process.pid)


def test_kills_all_below_but_the_spared(parent: int) -> None:
    (child,) = process_tree.descendants(parent)
    process_tree.kill_descendants(parent, spared_pid=child)
    assert process_tree.resident_bytes(child) > 0
    process_tree.kill_descendants(parent)
    while process_tree.resident_bytes(child):
        pass
    assert process_tree.resident_bytes(parent) > 0


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
