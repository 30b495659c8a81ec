"""Tables in Parquet, with the types that LeRobot's readers expect; by PyArrow."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .layout import Feature

if TYPE_CHECKING:
    import pyarrow as pa


def make_column(values: Any, feature: Feature) -> "pa.Array":
    """Return the entries of a column: numbers, lists of a fixed length, or lists of lists where it has more axes."""
    import pyarrow as pa

    if feature.dtype == "string":
        return pa.array(values, pa.string())
    array = np.asarray(values, dtype=feature.dtype)
    column = pa.array(array.reshape(-1))
    if feature.shape == (1,):
        return column
    if len(feature.shape) == 1:
        return pa.FixedSizeListArray.from_arrays(column, feature.shape[0])
    for length in reversed(feature.shape):
        offsets = np.arange(0, len(column) + 1, length, dtype=np.int32)
        column = pa.ListArray.from_arrays(offsets, column)
    return column


def write_table(path: Path, parts: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of parts with the same columns, or of rows."""
    import pyarrow as pa
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(next(iter(parts[0].values())), pa.Array):
        table = pa.concat_tables(pa.table(dict(part)) for part in parts)
    else:
        table = pa.Table.from_pylist([dict(part) for part in parts])
    parquet.write_table(table.combine_chunks(), path)


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks as version 3.0 has them: a data frame of pandas whose index is the text."""
    import pyarrow as pa
    from pyarrow import parquet

    index = "__index_level_0__"
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: pa.array(tasks, pa.string())})
    described: list[dict[str, Any]] = [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object"},
    ]
    pandas: dict[str, Any] = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [{**each, "metadata": None} for each in described],
        "pandas_version": "2.0.0",
    }
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path)
