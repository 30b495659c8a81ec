"""The file format: a JSON header and named arrays, compressed with gzip. `viewer/container.js` reads it.

After the magic comes the header's length as a 32-bit number, the header, and the arrays' bytes, little-endian, each at
a multiple of four bytes from the end of the header, which is padded to such a multiple itself.
"""

import gzip
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vitac.errors import VitacError

MAGIC: Final = b"VITACPB1"
_LENGTH = struct.Struct("<I")
_ALIGNMENT = 4
_TYPES = frozenset({"uint8", "int16", "uint16", "float32"})


class PlaybackTooLarge(VitacError):
    """An episode does not fit into a playback file; the message says how large it may be."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Changes:
    """An array of whole numbers that is stored as the changes along its first axis, which compress well.

    Attributes:
        values: shape [n, ...].
    """

    values: NDArray[Any]


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | Changes]) -> bytes:
    """Return a file with a header and arrays of the types uint8, int16, uint16 and float32."""
    described: dict[str, Any] = {}
    body = bytearray()
    for name, array in arrays.items():
        are_changes = isinstance(array, Changes)
        values = array.values if isinstance(array, Changes) else array
        assert values.dtype.name in _TYPES, f"{name} is of {values.dtype}"  # noqa: S101 - our own callers
        # Whole numbers wrap around, so the sum of the changes gives the values back.
        stored = np.diff(values, axis=0, prepend=np.zeros_like(values[:1])) if are_changes else values
        described[name] = {"type": values.dtype.name, "shape": values.shape, "at": len(body), "changes": are_changes}
        body += _padded(np.ascontiguousarray(stored, dtype=values.dtype.newbyteorder("<")).tobytes(), b"\0")
    text = _padded(json.dumps(dict(header) | {"arrays": described}, allow_nan=False).encode(), b" ")
    return gzip.compress(MAGIC + _LENGTH.pack(len(text)) + text + body, compresslevel=9, mtime=0)


def whole_numbers(values: ArrayLike, unit: float, dtype: type[np.integer[Any]]) -> NDArray[Any]:
    """Return values as multiples of a unit, those beyond the range of the type at its ends."""
    limits = np.iinfo(dtype)
    return np.clip(np.rint(np.asarray(values, dtype=np.float64) / unit), limits.min, limits.max).astype(dtype)


def _padded(content: bytes, with_byte: bytes) -> bytes:
    return content + with_byte * (-len(content) % _ALIGNMENT)
