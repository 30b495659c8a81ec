"""Reads playback files as the pages' script does."""

import gzip
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.playback_files.scene import MAGIC


@dataclass(frozen=True, kw_only=True, eq=False)
class Unpacked:
    """Header and arrays of a file; those that were stored as changes are summed up."""

    header: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def unpack(content: bytes) -> Unpacked:
    data = gzip.decompress(content)
    assert data.startswith(MAGIC)
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    start = len(MAGIC) + 4
    header = json.loads(data[start : start + length])
    return Unpacked(
        header=header, arrays={name: _array(data, start + length, it) for name, it in header["arrays"].items()}
    )


def _array(data: bytes, start: int, described: dict[str, Any]) -> NDArray[Any]:
    dtype = np.dtype(described["type"])
    at = start + described["at"]
    assert at % dtype.itemsize == 0
    count = int(np.prod(described["shape"]))
    values = np.frombuffer(data, dtype=dtype, count=count, offset=at).reshape(described["shape"])
    return np.cumsum(values, axis=0, dtype=dtype) if described["changes"] else values
