"""Charts for TensorBoard: what is written, and that a run without it writes none."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, BinaryIO

import pytest
from vitac.training.log import FOLDER, Charts

ROW = {"round": 2, "env_steps": 90, "student": {"episodes": 10, "interval": {"low": 0.25}}}


class Records:
    """As TensorBoard's writer of records: one after the other into a file."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, data: bytes) -> None:
        self._file.write(data + b"\n")

    def flush(self) -> None:
        self._file.flush()

    def close(self) -> None:
        self._file.close()


def event(**said: Any) -> SimpleNamespace:
    """As TensorBoard's event, told as text."""
    step, scalars = said.get("step"), said.get("summary", [])
    text = said.get("file_version") or " ".join(f"{tag}={value:g}" for tag, value in scalars)
    return SimpleNamespace(SerializeToString=lambda: f"{step} {text}".encode())


def summary(value: list[tuple[str, float]]) -> list[tuple[str, float]]:
    return value


summary.Value = lambda tag, simple_value: (tag, simple_value)  # type: ignore[attr-defined]


@pytest.fixture
def tensorboard(monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts a stand-in in the place of TensorBoard, so that what is written can be read."""
    modules: dict[str, dict[str, Any]] = {
        "tensorboard.compat.proto.event_pb2": {"Event": event},
        "tensorboard.compat.proto.summary_pb2": {"Summary": summary},
        "tensorboard.summary.writer.record_writer": {"RecordWriter": Records},
    }
    for name, content in modules.items():
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)
    monkeypatch.setattr("vitac.training.log.find_spec", lambda _: object())


def lines(run: Path) -> list[str]:
    (path,) = (run / FOLDER).iterdir()
    assert "tfevents" in path.name
    return path.read_text().splitlines()


@pytest.mark.usefixtures("tensorboard")
def test_numbers_of_a_row_are_charted_under_the_names_of_its_parts(tmp_path: Path) -> None:
    with Charts(tmp_path, print) as charts:
        charts.add_row(2, ROW)
        assert len(lines(tmp_path)) == 2, "seen while the run goes on"
    assert lines(tmp_path) == [
        "None brain.Event:2",
        "2 round=2 env_steps=90 student/episodes=10 student/interval/low=0.25",
    ]


@pytest.mark.usefixtures("tensorboard")
def test_losses_of_a_round_are_charted_turn_by_turn_also_where_one_learns_twice(tmp_path: Path) -> None:
    with Charts(tmp_path, print) as charts:
        for number, who, loss in ((1, "critic", 0.5), (1, "student", 0.75), (1, "student", 0.25), (2, "student", 1.0)):
            charts.add_loss(number, who, loss)
    assert lines(tmp_path)[1:] == [
        "1 loss in round 01/critic=0.5",
        "1 loss in round 01/student=0.75",
        "2 loss in round 01/student=0.25",
        "1 loss in round 02/student=1",
    ]


@pytest.mark.usefixtures("tensorboard")
def test_each_process_has_a_file_of_its_own_and_one_without_numbers_none(tmp_path: Path) -> None:
    with Charts(tmp_path, print):
        pass
    assert not list(tmp_path.iterdir())
    for number in (1, 2):
        with Charts(tmp_path, print) as charts:
            charts.add_row(number, ROW)
    assert len(list((tmp_path / FOLDER).iterdir())) == 2


def add_all(folder: Path) -> list[str]:
    """What is said of charts that cannot be written, with a loss, a row and the end of the run after it."""
    heard: list[str] = []
    with Charts(folder, heard.append) as charts:
        charts.add_loss(1, "critic", 0.5)
        charts.add_loss(1, "critic", 0.25)
        charts.add_row(1, ROW)
    return heard


@pytest.mark.usefixtures("tensorboard")
def test_a_full_disk_ends_the_charts_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[BinaryIO] = []

    def open_full(_: Path, mode: str) -> BinaryIO:
        opened.append(open("/dev/full", mode.replace("x", "w")))  # type: ignore[arg-type]  # noqa: PTH123, SIM115
        return opened[-1]

    monkeypatch.setattr(Path, "open", open_full)
    (told,) = add_all(tmp_path)
    assert "gets no more charts, the training continues: OSError: [Errno 28] No space" in told
    assert [file.closed for file in opened] == [True]


@pytest.mark.usefixtures("tensorboard")
def test_a_folder_that_cannot_be_made_is_told_once(tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("a file where the folder goes")
    (told,) = add_all(tmp_path)
    assert "gets no more charts, the training continues: FileExistsError" in told


@pytest.mark.usefixtures("tensorboard")
@pytest.mark.parametrize("error", [TypeError("Descriptors cannot be created directly."), ImportError("protobuf 7")])
def test_a_broken_tensorboard_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(**_: Any) -> None:
        raise error

    monkeypatch.setattr(sys.modules["tensorboard.compat.proto.event_pb2"], "Event", fail)
    (told,) = add_all(tmp_path)
    assert told.endswith(f"{type(error).__name__}: {error}")


def test_nothing_is_written_without_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.training.log.find_spec", lambda _: None)
    with Charts(tmp_path, print) as charts:
        charts.add_row(1, ROW)
        charts.add_loss(1, "critic", 0.5)
    assert not list(tmp_path.iterdir())


def test_tensorboard_itself_reads_them(tmp_path: Path) -> None:
    reading = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator", reason="TensorBoard is not installed"
    )
    with Charts(tmp_path, print) as charts:
        charts.add_row(1, {"solved": {"successes": 3}})
        charts.add_row(2, {"solved": {"successes": 8}})
    found = reading.EventAccumulator(str(tmp_path / FOLDER)).Reload()
    assert [(event.step, event.value) for event in found.Scalars("solved/successes")] == [(1, 3.0), (2, 8.0)]
