"""What a training tells about itself: its log, a line of JSON for each round, and charts for TensorBoard.

The log never gets shorter, and no training ends because of a chart.
"""

import json
import socket
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from time import time, time_ns
from types import TracebackType
from typing import Any, Self, TypeVar

from .files import FileDamaged, write_text

Row = Mapping[str, Any]
ResultT = TypeVar("ResultT")


def read_log(path: Path, of_row: Callable[[Row], ResultT]) -> list[ResultT]:
    """Return the rows of a log, none where there is no log.

    Raises:
        FileDamaged: a row is not what was written.
    """
    if not path.exists():
        return []
    try:
        return [of_row(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileDamaged(f"{path} does not hold what was written; delete it and run it again.") from error


def extend_log(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows, or leave a log that has as many: that of a run that got further, or of another process.

    Raises:
        NotSaved: it cannot be written.
    """
    if path.exists() and len(path.read_text(encoding="utf-8").splitlines()) >= len(rows):
        return
    write_text(path, "".join(json.dumps(row) + "\n" for row in rows))


Scalars = Mapping[str, float]

FOLDER = "tensorboard"
"""Name of the folder of charts, in the folder of a run."""


class Charts:
    """Numbers by name, each over the steps of its own kind; a context manager, because it keeps a file open.

    Args:
        run: folder of the run; the charts have one of their own in it, and each process that adds some a file.
        tell: is called once, with the reason why there will be no more of them, such as a full disk.
    """

    def __init__(self, run: Path, tell: Callable[[str], None]) -> None:
        self._folder = run / FOLDER
        self._tell = tell
        self._is_wanted = find_spec("tensorboard") is not None
        self._records: Any = None
        self._turns: Counter[str] = Counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def add_row(self, number: int, row: Mapping[str, Any]) -> None:
        """Add all numbers of a row of the log, those of a part of it under the name of the part."""
        self._add(number, dict(_numbers(row)))

    def add_loss(self, number: int, who: str, loss: float) -> None:
        """Add the loss of the next turn in which someone learned in a round."""
        name = f"loss in round {number:02}/{who}"
        self._turns[name] += 1
        self._add(self._turns[name], {name: loss})

    def _add(self, step: int, scalars: Scalars) -> None:
        if not self._is_wanted:
            return
        try:
            self._write(step, scalars)
        except Exception as error:  # noqa: BLE001 - a broken TensorBoard or protobuf raises whatever it likes
            self._is_wanted = False
            self._close()
            self._tell(f"{self._folder} gets no more charts, the training continues: {type(error).__name__}: {error}")

    def _write(self, step: int, scalars: Scalars) -> None:
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.compat.proto.summary_pb2 import Summary

        values = [Summary.Value(tag=tag, simple_value=value) for tag, value in scalars.items()]
        if self._records is None:
            self._open()
        self._records.write(Event(wall_time=time(), step=step, summary=Summary(value=values)).SerializeToString())
        self._records.flush()

    def _open(self) -> None:
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.summary.writer.record_writer import RecordWriter

        self._folder.mkdir(parents=True, exist_ok=True)
        name = f"events.out.tfevents.{time_ns()}.{socket.gethostname()}"
        self._records = RecordWriter((self._folder / name).open("xb"))
        self._records.write(Event(wall_time=time(), file_version="brain.Event:2").SerializeToString())

    def _close(self) -> None:
        if self._records is not None:
            with suppress(OSError):  # each record was flushed when it was added; one that could not be was reported
                self._records.close()
            self._records = None


def _numbers(row: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a row with their names, level by level."""
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{above}{name}/")
        else:
            yield f"{above}{name}", float(value)
