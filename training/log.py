"""The log of a run or a search: what each round or generation found, a line of JSON each. It never gets shorter."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

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
