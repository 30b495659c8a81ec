"""Arrays in MessagePack as policy servers write them: maps with `__ndarray__`, data, dtype and shape.

Of what arrives only numbers are ever made: no pickle, no objects, no pictures; called by `protocols`.
"""

import math
import re
import struct
import zlib
from collections.abc import Mapping
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..agent.protocol import violation
from ..agent.verdicts import PolicyFailed, VerdictCode

ANSWER_BYTES: Final = 1024 * 1024
"""Length of a message from a policy: a thousand actions of a hundred numbers. In memory it takes 64 times as much."""
_AXES_MAX: Final = 8
_NUMERIC: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248])")
_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES: Final = {1: 0, 3: 2, 4: 6}
"""Colour type of a PNG by its number of channels."""


def encode(message: Mapping[Any, Any], *, binary_keys: bool, png: bool = False) -> bytes:
    """Return a message as MessagePack.

    Args:
        message: text, numbers, arrays, and lists and maps of them.
        binary_keys: whether the keys of an array's map are bytes, as openpi has them, or text.
        png: whether pictures, arrays of bytes with 1, 3 or 4 channels, are written as PNG.
    """

    def write_array(value: object) -> object:
        if not isinstance(value, np.ndarray):
            raise TypeError(f"Expected text, numbers and arrays, got {type(value).__name__}.")
        if png and value.dtype == np.uint8 and value.ndim == 3 and value.shape[2] in _COLOUR_TYPES:
            return {"__image__": True, "format": "png", "data": encode_png(value), "shape": list(value.shape)}
        fields = {"__ndarray__": True, "data": value.tobytes(), "dtype": value.dtype.str, "shape": list(value.shape)}
        return {key.encode(): field for key, field in fields.items()} if binary_keys else fields

    return msgspec.msgpack.encode(message, enc_hook=write_array)


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture, shape [height, width, channels], as PNG (W3C Portable Network Graphics, sections 5 and 11)."""
    height, width, channels = picture.shape
    head = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPES[channels], 0, 0, 0)
    rows = np.zeros((height, 1 + width * channels), np.uint8)  # each begins with its filter: none
    rows[:, 1:] = picture.reshape(height, -1)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.data, level=1)), (b"IEND", b""))
    return _PNG_SIGNATURE + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def decode_png(data: bytes) -> NDArray[np.uint8]:
    """Return a picture that `encode_png` has written."""
    fields: dict[bytes, bytes] = {}
    place = len(_PNG_SIGNATURE)
    while place < len(data):
        length, name = struct.unpack_from(">I4s", data, place)
        fields[name] = data[place + 8 : place + 8 + length]
        place += length + 12
    width, height, _, colour_type = struct.unpack_from(">IIBB", fields[b"IHDR"])
    channels = next(number for number, colour in _COLOUR_TYPES.items() if colour == colour_type)
    rows = np.frombuffer(zlib.decompress(fields[b"IDAT"]), np.uint8).reshape(height, 1 + width * channels)
    return rows[:, 1:].reshape(height, width, channels)


def decode(data: bytes) -> dict[Any, Any]:
    """Return the map that a message holds, its arrays still as maps.

    Raises:
        PolicyFailed: protocol_violation.
    """
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise violation(f"Expected a message in MessagePack, got {len(data)} bytes that are none: {error}.") from None
    if not isinstance(message, dict):
        raise violation(f"Expected a message that is a map, got {type(message).__name__}.")
    return message


def read_field(message: Mapping[Any, Any], name: str) -> Any:
    """Return a field, whose name may be text or bytes; None where there is none."""
    return message[name] if name in message else message.get(name.encode())


def read_array(value: object) -> NDArray[np.generic]:
    """Return the numbers of a field: the map of an array, or numbers in lists.

    Raises:
        PolicyFailed: bad_action_type, or protocol_violation where type, shape and bytes do not agree.
    """
    if isinstance(value, Mapping) and read_field(value, "__ndarray__"):
        return _read_map(value)
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise PolicyFailed(VerdictCode.BAD_ACTION_TYPE, f"Expected an array of numbers, got {error}.") from None
    if array.dtype.kind not in "fiu":
        got = type(value).__name__ if array.ndim == 0 else f"an array of {array.dtype}"
        raise PolicyFailed(VerdictCode.BAD_ACTION_TYPE, f"Expected an array of numbers, got {got}.")
    return array


def read_value(value: Any) -> NDArray[Any]:
    """Return an array or a picture that `encode` has written."""
    is_picture = isinstance(value, Mapping) and "__image__" in value
    return decode_png(value["data"]) if is_picture else read_array(value)


def _read_map(value: Mapping[Any, Any]) -> NDArray[np.generic]:
    data, dtype, shape = (read_field(value, name) for name in ("data", "dtype", "shape"))
    code = dtype.decode("ascii", "replace") if isinstance(dtype, bytes) else str(dtype)
    if not _NUMERIC.fullmatch(code):
        raise PolicyFailed(
            VerdictCode.BAD_ACTION_TYPE,
            f"Expected an array of integers or floating-point numbers, got dtype {code!r:.40}.",
        )
    if not isinstance(data, bytes) or not isinstance(shape, list) or len(shape) > _AXES_MAX:
        raise violation("Expected an array with bytes as its data and a list of at most 8 numbers as its shape.")
    if any(type(length) is not int or not 0 <= length <= ANSWER_BYTES for length in shape):
        raise violation(f"Expected the shape of an array to be made of numbers from 0 on, got {shape!r:.80}.")
    expected = math.prod(shape) * np.dtype(code).itemsize
    if len(data) != expected:
        raise violation(f"An array of shape {shape} and type {code} has {expected} bytes, got {len(data)}.")
    return np.frombuffer(data, code).reshape(shape)
