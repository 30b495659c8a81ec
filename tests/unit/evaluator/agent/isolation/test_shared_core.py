import os
import subprocess
from collections.abc import Iterator

import pytest
from vitac.evaluator.agent.isolation import shared_core
from vitac.evaluator.agent.isolation.shared_core import SharedCore


@pytest.fixture
def cores() -> Iterator[list[int]]:
    """The cores of this process, which runs on the first of them until a test moves it."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    yield sorted(allowed)
    os.sched_setaffinity(0, allowed)


@pytest.fixture
def process() -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as started:
        os.sched_setaffinity(started.pid, range(os.cpu_count() or 1))
        yield started
        started.kill()


def test_runs_processes_where_this_one_runs(cores: list[int], process: "subprocess.Popen[bytes]") -> None:
    shared = SharedCore()

    shared.add(process.pid)
    assert os.sched_getaffinity(process.pid) == {cores[0]}

    os.sched_setaffinity(0, {cores[-1]})
    shared.follow()
    assert os.sched_getaffinity(process.pid) == {cores[-1]}


def test_leaves_a_removed_process_where_it_is(cores: list[int], process: "subprocess.Popen[bytes]") -> None:
    if len(cores) < 2:
        pytest.skip("This process may run on one core only.")
    shared = SharedCore()
    shared.add(process.pid)

    shared.remove(process.pid)
    os.sched_setaffinity(0, {cores[-1]})
    shared.follow()

    assert os.sched_getaffinity(process.pid) == {cores[0]}


def test_leaves_processes_alone_where_the_kernel_does_not_name_the_core(
    process: "subprocess.Popen[bytes]", monkeypatch: pytest.MonkeyPatch
) -> None:
    before = os.sched_getaffinity(process.pid)
    monkeypatch.setattr(shared_core, "_current_core", lambda: -1)
    SharedCore().add(process.pid)
    assert os.sched_getaffinity(process.pid) == before


def test_passes_over_a_process_that_has_ended(process: "subprocess.Popen[bytes]") -> None:
    process.kill()
    process.wait()

    SharedCore().add(process.pid)
