import io
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.progress import Progress, TaskID
from vitac.cli.terminal import compiling
from vitac.cli.terminal.compiling import ONCE, compiling_shown
from vitac.envs import kernel_cache
from vitac.envs.kernel_cache import CompileProgress, CompilingTurn
from worker_fakes import eventually

STARTED = f"vitac: compiling the physics {ONCE}\n"
DONE = "vitac: compiled the physics\n"
LIMIT_S = 120.0


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of kernels of this test alone, watched without pause."""
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_POLL_S", 0.001)
    before = set(threading.enumerate())
    yield tmp_path / "kernels"
    eventually(lambda: set(threading.enumerate()) <= before)


def progress(compiled: int) -> CompileProgress:
    return CompileProgress(compiled=compiled, kernels=166)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Watched(Progress):
    """A progress bar that tells when its tasks were changed."""

    def __init__(self) -> None:
        super().__init__(console=Console(file=io.StringIO(), force_terminal=True))
        self.changed = threading.Condition()

    def update(self, *arguments: Any, **changes: Any) -> None:
        super().update(*arguments, **changes)
        with self.changed:
            self.changed.notify_all()

    def remove_task(self, task_id: TaskID) -> None:
        super().remove_task(task_id)
        with self.changed:
            self.changed.notify_all()

    def wait_for_lines(self, *lines: tuple[str, float, float | None]) -> None:
        def seen() -> bool:
            return [(task.description, task.completed, task.total) for task in self.tasks] == list(lines)

        with self.changed:
            while not seen():
                assert self.changed.wait(LIMIT_S), [vars(task) for task in self.tasks]


def test_nothing_is_written_where_nothing_is_compiled(kernels: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with compiling_shown():
        pass
    assert capsys.readouterr() == ("", "")


def test_a_pipe_gets_a_line_at_the_start_and_one_at_the_end(kernels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = io.StringIO()
    told = threading.Event()

    class Pipe(io.StringIO):
        def write(self, text: str) -> int:
            told.set()
            return lines.write(text)

    monkeypatch.setattr("sys.stderr", Pipe())
    with compiling_shown():
        turn = CompilingTurn()
        kernels.mkdir(exist_ok=True)
        with turn.taken(kernels, progress(0)):
            assert told.wait(LIMIT_S)
            turn.tell(progress(5))
            told.clear()
        assert told.wait(LIMIT_S)
    assert lines.getvalue() == STARTED + DONE


def test_the_end_is_written_where_the_command_ends_first(kernels: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = compiling_shown()
    polls = 0

    class Often:
        @staticmethod
        def read_own_processes(_: Path) -> CompileProgress:
            nonlocal polls
            polls += 1
            seen.set()
            return progress(polls)

    seen = threading.Event()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiling, "CompileProgress", Often)
        with shown:
            assert seen.wait(LIMIT_S)
    assert capsys.readouterr().err == STARTED + DONE


def test_the_bar_of_a_command_gets_a_line_more(kernels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Terminal())
    bar = Watched()
    bar.add_task("starting", total=2)
    mine = ("starting", 0, 2)
    with compiling_shown(bar):
        turn = CompilingTurn()
        kernels.mkdir(exist_ok=True)
        with turn.taken(kernels, progress(0)):
            bar.wait_for_lines(mine, (f"compiling the physics {ONCE}", 0, 166))
            turn.tell(progress(30))
            bar.wait_for_lines(mine, (f"compiling the physics {ONCE}", 30, 166))
    bar.wait_for_lines(mine)


def test_a_terminal_gets_a_bar_while_it_lasts(kernels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    bar = Watched()
    monkeypatch.setattr(compiling, "_own_bar", lambda: bar)
    with compiling_shown():
        kernels.mkdir(exist_ok=True)
        for compiled in (1, 2):
            with CompilingTurn().taken(kernels, progress(compiled)):
                bar.wait_for_lines((f"compiling the physics {ONCE}", compiled, 166))
                assert bar.live.is_started
    bar.wait_for_lines()
    assert not bar.live.is_started


def test_an_error_of_the_command_is_raised(kernels: Path) -> None:
    with pytest.raises(ZeroDivisionError), compiling_shown():
        raise ZeroDivisionError


def test_a_cache_that_cannot_be_written_is_not_watched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path / "file"))
    assert kernel_cache.shared_directory() is None
    before = set(threading.enumerate())
    with compiling_shown():
        assert set(threading.enumerate()) <= before
    assert capsys.readouterr() == ("", "")
