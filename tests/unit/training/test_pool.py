"""The pool gives results in order, whatever processes are lost. On a Ray cluster: `tests/integration/libraries`."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import count, islice
from pathlib import Path

import pytest
from vitac.envs.extras import ExtraMissing
from vitac.training.folder_lock import FolderInUse, hold_folder
from vitac.training.pool import ProcessesLost, map_in_order


def square(number: int) -> int:
    return number * number


def end_once(folder: Path, number: int) -> int:
    """End the process at every third number, the first time that it comes."""
    mark = folder / str(number)
    if number % 3 == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


def end_always(number: int) -> int:
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


@pytest.mark.parametrize("processes", [1, 3])
def test_results_come_in_order_of_items_without_end(processes: int) -> None:
    results = map_in_order(square, count(), processes)
    assert list(islice(results, 20)) == [square(number) for number in range(20)]


def test_a_process_that_is_killed_is_replaced_and_its_items_are_worked_on_again(tmp_path: Path) -> None:
    """With a plain pool of multiprocessing this never ends."""
    assert list(map_in_order(partial(end_once, tmp_path), range(8), 2)) == [square(number) for number in range(8)]


def test_an_item_that_kills_its_process_again_and_again_is_named() -> None:
    results = map_in_order(end_always, range(8), 2)
    assert list(islice(results, 2)) == [0, 1]
    with pytest.raises(ProcessesLost, match="ended 3 times while it worked on 2 or the items after it"):
        list(results)


def test_without_ray_the_command_that_installs_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.envs.extras.find_spec", lambda name: None if name == "ray" else object())
    with pytest.raises(ExtraMissing, match=r"ray is not installed. --ray needs the extra .ray."):
        next(map_in_order(square, range(2), ray="auto"))


WRITER = """
import os, sys, time
from pathlib import Path
from vitac.cli.terminal.stopping import stopped_by_signals
from vitac.training.folder_lock import hold_folder
from vitac.training.pool import map_in_order

folder = Path(sys.argv[1])

def work(number):
    (folder / f"child-{os.getpid()}").touch()
    time.sleep(600)

with hold_folder(folder), stopped_by_signals("run it again"):
    list(map_in_order(work, range(8), 3))
"""


def until(holds: Callable[[], bool]) -> bool:
    """Wait until something holds, at most half a minute."""
    deadline = time.monotonic() + 30.0
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.02)
    return holds()


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.parametrize(("by", "code"), [(signal.SIGKILL, -9), (signal.SIGTERM, 128 + 15)])
def test_processes_end_with_the_one_that_started_them_and_give_its_folder_back(
    tmp_path: Path, by: signal.Signals, code: int
) -> None:
    said = tmp_path / "said"
    with said.open("w") as stderr:
        main = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stderr=stderr)
    assert until(lambda: len(list(tmp_path.glob("child-*"))) == 3)
    children = [int(path.name.removeprefix("child-")) for path in tmp_path.glob("child-*")]
    with pytest.raises(FolderInUse, match=rf"\(process {main.pid} on "), hold_folder(tmp_path):
        pass
    main.send_signal(by)
    assert main.wait(30) == code
    assert until(lambda: not any(map(is_alive, children)))
    with hold_folder(tmp_path):
        assert f"process {os.getpid()} " in (tmp_path / ".lock").read_text()
    assert ("stopped; run it again" in said.read_text()) == (by is signal.SIGTERM)
