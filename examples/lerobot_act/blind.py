"""Copies a data set of `vitac data export` with zeros in place of touch, for a twin that learns from the same episodes.

python blind.py DATA_SET NEW_FOLDER
"""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

TOUCH = "observation.environment_state"


def main() -> None:
    """Copy, and replace touch in the tables and in their statistics."""
    folder = Path(sys.argv[2])
    shutil.copytree(sys.argv[1], folder)
    for path in (folder / "data").rglob("*.parquet"):
        table = pq.read_table(path)
        place = table.schema.get_field_index(TOUCH)
        zeros = np.zeros_like(np.array(table.column(place).to_pylist())).tolist()
        field = table.schema.field(place)
        pq.write_table(table.set_column(place, field, pa.array(zeros, field.type)), path)
    statistics = folder / "meta" / "stats.json"
    content = json.loads(statistics.read_text())
    content[TOUCH] = {
        name: values if name == "count" else [0.0] * len(values) for name, values in content[TOUCH].items()
    }
    statistics.write_text(json.dumps(content))


if __name__ == "__main__":
    main()
