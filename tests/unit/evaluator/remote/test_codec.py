import io
import struct
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.remote.codec import decode, encode, encode_png, read_array, read_field, read_value

BAD_TYPE, VIOLATION = VerdictCode.BAD_ACTION_TYPE, VerdictCode.PROTOCOL_VIOLATION


def array_map(**changes: Any) -> dict[str, Any]:
    """The map of an array of two numbers, with other fields."""
    return {"__ndarray__": True, "data": struct.pack("<2f", 1, 2), "dtype": "<f4", "shape": [2]} | changes


@given(
    st.sampled_from(["<f4", ">f8", "<f2", "u1", "<i8", ">i2"]).flatmap(
        lambda code: arrays(code, array_shapes(min_dims=0, min_side=0, max_dims=4))
    ),
    st.booleans(),
)
def test_arrays_arrive_as_they_were_sent(array: Any, binary_keys: bool) -> None:
    received = read_array(read_field(decode(encode({"actions": array}, binary_keys=binary_keys)), "actions"))
    assert received.dtype == array.dtype
    np.testing.assert_array_equal(received, array)


def test_numbers_in_lists_are_an_array() -> None:
    assert read_array([[1, 2.5], [3, 4]]).tolist() == [[1, 2.5], [3, 4]]


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pictures_are_png_where_the_server_reads_them(channels: int) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, channels), np.uint8)
    with Image.open(io.BytesIO(encode_png(picture))) as image:
        np.testing.assert_array_equal(np.asarray(image).reshape(picture.shape), picture)
    sent = decode(encode({"rgb": picture}, binary_keys=False, png=True))["rgb"]
    assert (sent["__image__"], sent["format"], sent["shape"]) == (True, "png", [5, 7, channels])
    np.testing.assert_array_equal(read_value(sent), picture)


@pytest.mark.parametrize(
    ("value", "verdict"),
    [
        (array_map(dtype="|O"), BAD_TYPE),
        (array_map(dtype="<c8"), BAD_TYPE),
        (array_map(dtype="<U2"), BAD_TYPE),
        (array_map(dtype="|b1"), BAD_TYPE),
        (array_map(dtype="f4,f4"), BAD_TYPE),
        (array_map(dtype=["<f4"]), BAD_TYPE),
        (array_map(shape=[3]), VIOLATION),
        (array_map(shape=[-1, -2]), VIOLATION),
        (array_map(shape=[2**62, 2**62]), VIOLATION),
        (array_map(shape=[1] * 9 + [2]), VIOLATION),
        (array_map(shape=[True, 2]), VIOLATION),
        (array_map(shape=2), VIOLATION),
        (array_map(data="text"), VIOLATION),
        ({b"__ndarray__": True}, BAD_TYPE),
        ({"no": "array"}, BAD_TYPE),
        ([[1, 2], [3]], BAD_TYPE),
        ([2**70], BAD_TYPE),
        (["1"], BAD_TYPE),
        ([True], BAD_TYPE),
        (b"\x80\x04.", BAD_TYPE),
        (msgspec.msgpack.Ext(1, b"x"), BAD_TYPE),
    ],
)
def test_everything_but_numbers_is_refused(value: Any, verdict: VerdictCode) -> None:
    with pytest.raises(PolicyFailed) as failure:
        read_array(value)
    assert failure.value.verdict is verdict


@pytest.mark.parametrize(
    "data", [b"", b"\xc1", b"\x91" * 100_000 + b"\xc0", b"\x81\x80\x01", b"\xdd\xff\xff\xff\xff", b"\x01", b"\xa1\xff"]
)
def test_messages_that_are_no_maps_are_refused(data: bytes) -> None:
    with pytest.raises(PolicyFailed, match="protocol_violation: Expected a message"):
        decode(data)
