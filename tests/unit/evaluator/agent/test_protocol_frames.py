import importlib.util
import json
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy
from vitac.envs.vision import optics
from vitac.evaluator.agent import runtime
from vitac.evaluator.agent.protocol import (
    HEADER_MAX_BYTES,
    AnswerKind,
    CloudSpec,
    FrameReader,
    PolicyAnswer,
    PolicyQuestion,
    QuestionKind,
    UnsendableObservation,
    array_code,
    encode_question,
)
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode

DTYPES = ("u1", "<u2", "<i4", "<i8", "<f4", "<f8", "?")


def load_runtime() -> ModuleType:
    """The runtime as a module; inside the sandbox it is a script that imports nothing of ours."""
    path = Path(next(iter(runtime.__path__)), "agent.py")
    spec = importlib.util.spec_from_file_location("sandbox_agent", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


AGENT = load_runtime()


@pytest.fixture
def far_end() -> Iterator[tuple[socket.socket, Any]]:
    """Our raw socket, and the runtime's connection at the other end."""
    ours, theirs = socket.socketpair()
    connection = AGENT.Connection(theirs.detach())
    yield ours, connection
    ours.close()
    connection._socket.close()


def frame(header: object = None, payload: bytes = b"", *, magic: bytes = b"VTC1") -> bytes:
    default = {"seq": 1, "kind": "action", "arrays": []}
    data = header if isinstance(header, bytes) else json.dumps(default if header is None else header).encode()
    return struct.pack("<4sIQ", magic, len(data), len(payload)) + data + payload


def answer_with(shape: list[int], payload: bytes, dtype: str = "f4") -> bytes:
    return frame({"seq": 1, "kind": "action", "arrays": [{"name": "a", "dtype": dtype, "shape": shape}]}, payload)


def read(data: bytes, *, message_bytes: int = 1 << 20) -> PolicyAnswer | None:
    return FrameReader(message_bytes=message_bytes).feed(data, sender_pid=7)


def refusal(data: bytes, *, message_bytes: int = 1 << 20) -> str:
    with pytest.raises(PolicyFailed) as caught:
        read(data, message_bytes=message_bytes)
    assert caught.value.verdict is VerdictCode.PROTOCOL_VIOLATION
    return caught.value.message


@given(st.data(), st.sampled_from(DTYPES), st_numpy.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
def test_arrays_reach_the_policy_unchanged(data: st.DataObject, dtype: str, shape: tuple[int, ...]) -> None:
    value = data.draw(st_numpy.arrays(dtype, shape))
    ours, theirs = socket.socketpair()
    with ours:
        ours.sendall(
            b"".join(encode_question(5, PolicyQuestion(kind=QuestionKind.OBSERVE, text="ü", arrays={"x": value})))
        )
        connection = AGENT.Connection(theirs.detach())
        kind, text, arrays = connection.read()
        connection._socket.close()
    assert (kind, text) == ("observe", "ü")
    assert arrays["x"].dtype == value.dtype
    assert arrays["x"].shape == shape
    assert arrays["x"].tobytes() == value.tobytes()
    assert arrays["x"].flags.writeable


@pytest.mark.parametrize(
    "value",
    [
        np.arange(6, dtype=">f4").reshape(2, 3),
        np.asfortranarray(np.arange(6, dtype=np.float64).reshape(2, 3)),
        np.arange(12, dtype=np.int64)[::2],
    ],
    ids=["big-endian", "column-major", "strided"],
)
def test_other_memory_layouts_are_converted(value: Any, far_end: tuple[socket.socket, Any]) -> None:
    ours, connection = far_end
    ours.sendall(b"".join(encode_question(1, PolicyQuestion(kind=QuestionKind.OBSERVE, arrays={"x": value}))))
    assert np.array_equal(connection.read()[2]["x"], value)


@pytest.mark.parametrize("dtype", ["O", "c8", "f2", "U3", "M8[s]", "i1"])
def test_refuses_to_send_other_types(dtype: str) -> None:
    with pytest.raises(UnsendableObservation, match="expected one of"):
        array_code(np.zeros(1, dtype=dtype))


@pytest.mark.parametrize(
    ("question", "kind"),
    [(QuestionKind.OBSERVE, AnswerKind.ACTION), (QuestionKind.BELIEVE, AnswerKind.BELIEF)],
)
def test_runtime_answers_are_read(far_end: tuple[socket.socket, Any], question: QuestionKind, kind: AnswerKind) -> None:
    ours, connection = far_end
    for numbers in (np.array([1, 2, 3], dtype="<f4"), None):
        ours.sendall(b"".join(encode_question(3, PolicyQuestion(kind=question))))
        assert connection.read()[0] == question
        connection.write(str(kind), numbers=numbers)
        answer = read(ours.recv(1 << 16))
        assert answer is not None
        assert (answer.header.seq, answer.header.kind, answer.sender_pid) == (3, kind, 7)
        told = {name: array.tolist() for name, array in answer.arrays.items()}
        assert told == ({} if numbers is None else {str(kind): [1, 2, 3]}), "the array has the name of the kind"


def test_answer_may_come_in_any_pieces() -> None:
    data = answer_with([2], struct.pack("<2f", 1, 2))
    reader = FrameReader(message_bytes=1000)
    answers = [reader.feed(data[index : index + 1], sender_pid=7) for index in range(len(data))]
    assert [answer is None for answer in answers] == [True] * (len(data) - 1) + [False]
    assert reader.is_empty


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"HTTP/1.1 200 OK", "message that starts with"),
        (b"\x80\x04\x95", "message that starts with"),
        (frame(magic=b"VTC2"), "message that starts with"),
        (struct.pack("<4sIQ", b"VTC1", HEADER_MAX_BYTES + 1, 0), "header of"),
        (struct.pack("<4sIQ", b"VTC1", 10, 1 << 63), "at most"),
        (frame(b"{"), "not a valid answer header"),
        (frame(b"\xff\xff"), "not a valid answer header"),
        (frame(b"[" * 30_000), "not a valid answer header"),
        (frame([]), "not a valid answer header"),
        (frame({"seq": 1}), "not a valid answer header"),
        (frame({"seq": -1, "kind": "action"}), "not a valid answer header"),
        (frame({"seq": 1.5, "kind": "action"}), "not a valid answer header"),
        (frame({"seq": 1, "kind": "observe"}), "not a valid answer header"),
        (frame({"seq": 1, "kind": "action", "success": True}), "not a valid answer header"),
        (frame({"seq": 1, "kind": "failed", "message": "x" * 5000}), "not a valid answer header"),
        (answer_with([3], b"\0" * 8), "have 12 bytes"),
        (answer_with([2], b"\0" * 12), "have 8 bytes"),
        (answer_with([-1], b""), "not a valid answer header"),
        (answer_with([1 << 40], b""), "not a valid answer header"),
        (answer_with([1 << 31] * 8, b""), "The arrays of the message have"),
        (answer_with([1] * 9, b"\0" * 4), "not a valid answer header"),
        (answer_with([1], b"\0" * 8, dtype="O"), "not a valid answer header"),
        (answer_with([1], b"\0" * 8) + b"more", "have 4 bytes"),
        (frame() + b"more", "more bytes"),
    ],
)
def test_refuses_everything_that_is_no_answer(data: bytes, told: str) -> None:
    assert told in refusal(data)


def test_refuses_two_arrays_of_one_name() -> None:
    specs = [{"name": "a", "dtype": "u1", "shape": [1]}] * 2
    assert "same name" in refusal(frame({"seq": 1, "kind": "action", "arrays": specs}, b"ab"))


def test_refuses_too_large_before_the_first_buffer_byte() -> None:
    assert "at most 100" in refusal(struct.pack("<4sIQ", b"VTC1", 10, 101), message_bytes=100)


def test_refuses_a_message_from_two_processes() -> None:
    reader = FrameReader(message_bytes=100)
    reader.feed(b"VTC1", sender_pid=7)
    with pytest.raises(PolicyFailed, match="two processes"):
        reader.feed(b"\0\0\0\0", sender_pid=8)


@given(st.binary(max_size=200), st.integers(0, 60))
def test_no_bytes_raise_anything_but_a_verdict(noise: bytes, position: int) -> None:
    data = answer_with([2], os.urandom(8))
    mixed = data[:position] + noise + data[position + len(noise) :]
    try:
        read(mixed)
    except PolicyFailed as failure:
        verdict = failure.verdict
    else:
        verdict = VerdictCode.PROTOCOL_VIOLATION
    assert verdict is VerdictCode.PROTOCOL_VIOLATION


@pytest.mark.parametrize("keep_depth", [True, False])
def test_runtime_makes_the_cloud_that_the_environment_would(
    keep_depth: bool, far_end: tuple[socket.socket, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit; the depth picture goes on to the policy only where it reads that, too."""
    monkeypatch.setattr(AGENT, "BACK_PROJECTION", Path(optics.__file__))
    depth_m = np.random.default_rng(0).uniform(0.0, 1.0, (30, 40)).astype(np.float32)
    lens = [604.3075, 603.0, 317.2341, 233.7944]
    spec = CloudSpec(name="cloud", depth="depth", keep_depth=keep_depth, intrinsics=lens)
    ours, connection = far_end
    question = PolicyQuestion(kind=QuestionKind.OBSERVE, arrays={"depth": depth_m}, clouds=(spec,))
    ours.sendall(b"".join(encode_question(1, question)))
    arrays = connection.read()[2]
    assert set(arrays) == ({"depth", "cloud"} if keep_depth else {"cloud"})
    expected = optics.point_cloud(depth_m, tuple(lens))
    assert arrays["cloud"].dtype == np.float32
    assert arrays["cloud"].tobytes() == expected.tobytes()
