"""What the evaluator and a sandbox say to each other: frames of bytes, on a channel with deadlines."""

import array
import fcntl
import math
import socket
import struct
import sys
import termios
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from .verdicts import PolicyFailed, VerdictCode

PREFIX: Final = struct.Struct("<4sIQ")
"""Magic, header [bytes], buffers together [bytes]."""
MAGIC: Final = b"VTC1"
HEADER_MAX_BYTES: Final = 32 * 1024


Array = NDArray[np.generic]
DtypeCode = Literal["u1", "u2", "i2", "i4", "i8", "f4", "f8", "b1"]
_DTYPES: Final[Mapping[str, np.dtype[np.generic]]] = {
    code: np.dtype(f"<{code}" if code not in {"u1", "b1"} else code)
    for code in ("u1", "u2", "i2", "i4", "i8", "f4", "f8", "b1")
}
_CODES: Final = {(dtype.kind, dtype.itemsize): code for code, dtype in _DTYPES.items()}


class QuestionKind(StrEnum):
    """What the evaluator asks."""

    LOAD = "load"
    RESET = "reset"
    OBSERVE = "observe"
    BELIEVE = "believe"


class AnswerKind(StrEnum):
    """What the runtime in the sandbox answers."""

    LOADED = "loaded"
    READY = "ready"
    ACTION = "action"
    BELIEF = "belief"
    FAILED = "failed"


class ArraySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One buffer of a frame; its bytes follow in the order of the specs."""

    name: Annotated[str, msgspec.Meta(max_length=64)]
    dtype: DtypeCode
    shape: Annotated[list[Annotated[int, msgspec.Meta(ge=0, le=2**31)]], msgspec.Meta(max_length=8)]

    @property
    def n_bytes(self) -> int:
        """Bytes of the buffer."""
        return math.prod(self.shape) * _DTYPES[self.dtype].itemsize


class CloudSpec(msgspec.Struct, frozen=True):
    """A point cloud that the runtime makes of a depth picture among the arrays, because it is three times as large."""

    name: str
    depth: str
    keep_depth: bool
    """Whether the policy gets the depth picture, too."""
    intrinsics: list[float]
    """Focal lengths and principal point in u and v [px]."""


def add_clouds(clouds: Sequence[CloudSpec], observation: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return an observation with the point clouds that follow from its depth pictures."""
    arrays = dict(observation)
    if clouds:
        from vitac.envs.vision.optics import point_cloud

        for cloud in clouds:
            arrays[cloud.name] = point_cloud(observation[cloud.depth], tuple(cloud.intrinsics))
        for cloud in clouds:
            if not cloud.keep_depth:
                arrays.pop(cloud.depth, None)
    return arrays


class QuestionHeader(msgspec.Struct, frozen=True):
    """Header of a frame to the policy."""

    seq: int
    kind: QuestionKind
    text: str
    arrays: list[ArraySpec]
    clouds: list[CloudSpec]


@dataclass(frozen=True, kw_only=True)
class PolicyQuestion:
    """What one frame to the policy says."""

    kind: QuestionKind
    text: str = ""
    arrays: Mapping[str, Array] = field(default_factory=dict)
    clouds: Sequence[CloudSpec] = ()


class AnswerHeader(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Header of a frame from the policy; everything in it is untrusted."""

    seq: Annotated[int, msgspec.Meta(ge=0, le=2**53)]
    kind: AnswerKind
    code: Annotated[str, msgspec.Meta(max_length=64)] = ""
    message: Annotated[str, msgspec.Meta(max_length=4096)] = ""
    arrays: Annotated[list[ArraySpec], msgspec.Meta(max_length=16)] = []


@dataclass(frozen=True, kw_only=True)
class PolicyAnswer:
    """One complete, well-formed frame from the policy."""

    header: AnswerHeader
    arrays: dict[str, Array]
    sender_pid: int
    """Process that sent it, as the kernel names it in the evaluator's pid namespace."""


class UnsendableObservation(VitacError):
    """An observation holds an array of a type that the channel does not carry: convert it to one of the allow-list."""


def violation(message: str) -> PolicyFailed:
    """Return the verdict for bytes that are not the one expected answer."""
    return PolicyFailed(VerdictCode.PROTOCOL_VIOLATION, message)


def array_code(value: Array) -> str:
    """Return the channel's code of an array's type.

    Raises:
        UnsendableObservation: its type is not in the allow-list.
    """
    code = _CODES.get((value.dtype.kind, value.dtype.itemsize))
    if code is None:
        raise UnsendableObservation(f"Array has dtype {value.dtype}, expected one of {', '.join(_DTYPES)}; convert it.")
    return code


def encode_question(seq: int, question: PolicyQuestion) -> list[memoryview]:
    """Return the parts of one frame to the policy, ready for `sendmsg`."""
    buffers: list[memoryview] = []
    specs: list[ArraySpec] = []
    for name, value in question.arrays.items():
        code = array_code(value)
        contiguous = np.ascontiguousarray(value, dtype=_DTYPES[code])
        specs.append(ArraySpec(name=name, dtype=code, shape=list(value.shape)))  # type: ignore[arg-type]
        if contiguous.size:
            buffers.append(contiguous.data.cast("B"))
    header = msgspec.json.encode(
        QuestionHeader(seq=seq, kind=question.kind, text=question.text, arrays=specs, clouds=list(question.clouds))
    )
    prefix = PREFIX.pack(MAGIC, len(header), sum(part.nbytes for part in buffers))
    return [memoryview(prefix + header), *buffers]


_decode_answer_header = msgspec.json.Decoder(AnswerHeader).decode


@dataclass(kw_only=True)
class FrameReader:
    """Puts answers together from whatever pieces the socket gives, and refuses everything else early.

    Sizes are checked on the prefix, so a frame that is too large is refused before its first buffer byte is stored.
    """

    message_bytes: int
    _buffer: bytearray = field(default_factory=bytearray)
    _header: AnswerHeader | None = None
    _sender_pid: int | None = None

    @property
    def is_empty(self) -> bool:
        """True where no piece of a frame is waiting."""
        return not self._buffer

    def feed(self, data: bytes, sender_pid: int) -> PolicyAnswer | None:
        """Take bytes that one process sent; return the answer once it is complete.

        Raises:
            PolicyFailed: protocol_violation.
        """
        if self._sender_pid not in {None, sender_pid}:
            raise violation(
                "Received one message from two processes; only the process that runs the policy may answer."
            )
        self._sender_pid = sender_pid
        self._buffer += data
        if len(self._buffer) < PREFIX.size:
            self._check_magic(bytes(self._buffer[:4]))
            return None
        header_bytes, payload_bytes = self._check_prefix()
        body_start = PREFIX.size + header_bytes
        if self._header is None and len(self._buffer) >= body_start:
            self._header = self._parse_header(bytes(self._buffer[PREFIX.size : body_start]), payload_bytes)
        if len(self._buffer) > body_start + payload_bytes:
            raise violation("Received more bytes than the one requested answer.")
        if self._header is None or len(self._buffer) < body_start + payload_bytes:
            return None
        return self._finish(self._header, body_start)

    def _finish(self, header: AnswerHeader, offset: int) -> PolicyAnswer:
        arrays: dict[str, Array] = {}
        for spec in header.arrays:
            piece = bytes(self._buffer[offset : offset + spec.n_bytes])
            arrays[spec.name] = np.frombuffer(piece, dtype=_DTYPES[spec.dtype]).reshape(spec.shape)
            offset += spec.n_bytes
        answer = PolicyAnswer(header=header, arrays=arrays, sender_pid=self._sender_pid or 0)
        self._buffer, self._header, self._sender_pid = bytearray(), None, None
        return answer

    @staticmethod
    def _check_magic(start: bytes) -> None:
        if not MAGIC.startswith(start):
            raise violation(f"Expected a message that starts with {MAGIC!r}, got {start!r}.")

    def _check_prefix(self) -> tuple[int, int]:
        magic, header_bytes, payload_bytes = PREFIX.unpack_from(self._buffer)
        self._check_magic(magic)
        if header_bytes > HEADER_MAX_BYTES:
            raise violation(f"Expected a message header of at most {HEADER_MAX_BYTES} bytes, got {header_bytes}.")
        if payload_bytes > self.message_bytes:
            raise violation(f"Expected a message of at most {self.message_bytes} bytes, got {payload_bytes}.")
        return header_bytes, payload_bytes

    @staticmethod
    def _parse_header(data: bytes, payload_bytes: int) -> AnswerHeader:
        try:
            header = _decode_answer_header(data)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise violation(f"The message header is not a valid answer header: {error}.") from error
        if len({spec.name for spec in header.arrays}) != len(header.arrays):
            raise violation("Two arrays of one message have the same name.")
        declared = sum(spec.n_bytes for spec in header.arrays)
        if declared != payload_bytes:
            raise violation(f"The arrays of the message have {declared} bytes, but its prefix says {payload_bytes}.")
        return header


ACTION_TYPES: Final = (
    "An action is a NumPy array, list, tuple or torch tensor (on the CPU, without gradient) of integers or "
    "floating-point numbers, which are converted to float32; truth values, complex numbers, text and objects fail the "
    "episode."
)
"""What `act` may return, as documents and the rules page say it."""


def checked_action(arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the action as float32 of the given shape, finite; it is not clipped here.

    Raises:
        PolicyFailed: protocol_violation, bad_action_type, bad_action_shape, non_finite_action.
    """
    return _checked("action", arrays, shape)


def checked_belief(arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """Return what a policy believes as float32 of the given shape, finite; None where it says nothing.

    Raises:
        PolicyFailed: as for an action.
    """
    return _checked("belief", arrays, shape) if arrays else None


def _checked(name: str, arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32]:
    if set(arrays) != {name}:
        raise PolicyFailed(
            VerdictCode.PROTOCOL_VIOLATION, f"An answer held the arrays {sorted(arrays)}, expected '{name}' alone."
        )
    numbers, title = arrays[name], name.capitalize()
    if numbers.dtype.kind not in "fiu":
        raise PolicyFailed(
            VerdictCode.BAD_ACTION_TYPE,
            f"{title} has dtype {numbers.dtype}, expected real numbers.",
        )
    if numbers.shape != shape:
        raise PolicyFailed(VerdictCode.BAD_ACTION_SHAPE, f"{title} has shape {numbers.shape}, expected {shape}.")
    with np.errstate(over="ignore", invalid="ignore"):
        converted = numbers.astype(np.float32)
    if not np.isfinite(converted).all():
        raise PolicyFailed(
            VerdictCode.NON_FINITE_ACTION,
            f"{title} is {numbers.tolist()}, expected finite numbers in the range of float32.",
        )
    return converted


_CHUNK_BYTES: Final = 64 * 1024
"""Small enough that the C library has such a piece at hand and need not ask the kernel for it."""
_PEEK: Final = int(socket.MSG_PEEK | socket.MSG_DONTWAIT)
_DO_NOT_WAIT: Final = int(socket.MSG_DONTWAIT)
_CUT_OFF: Final = int(socket.MSG_CTRUNC)
"""Plain numbers: to combine Python's own names of them takes longer than the system call."""
_CREDENTIALS_BYTES: Final = 12
"""struct ucred: pid, uid, gid."""


class Channel:
    """The evaluator's end of one socketpair; never blocks, the session waits for it together with all else."""

    def __init__(self, sock: socket.socket, *, message_bytes: int) -> None:
        sock.setblocking(False)
        if sys.platform == "linux":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._sock = sock
        self._reader = FrameReader(message_bytes=message_bytes)
        self._unsent: list[memoryview] = []
        self._seq = 0

    def fileno(self) -> int:
        """Return the descriptor to poll."""
        return self._sock.fileno()

    @property
    def has_unsent(self) -> bool:
        """True while a part of the question still waits for room in the socket."""
        return bool(self._unsent)

    def ask(self, question: PolicyQuestion) -> None:
        """Start sending the next question.

        Raises:
            PolicyFailed: protocol_violation, the policy has already sent unrequested data.
        """
        self.check_silent()
        self._seq += 1
        self._unsent = encode_question(self._seq, question)
        self.send_more()

    def send_more(self) -> None:
        """Send what the socket takes now; a closed far end is left to `receive` to report."""
        try:
            sent = self._sock.sendmsg(self._unsent)
        except BlockingIOError:
            return
        except (BrokenPipeError, ConnectionResetError):
            self._unsent = []
            return
        self._unsent = _unsent_parts(self._unsent, sent)

    def receive(self, expected: Sequence[AnswerKind]) -> PolicyAnswer | None:
        """Return the answer to the last question, None while it is not complete, or raise.

        Raises:
            PolicyFailed: protocol_violation, and `ChannelClosed` where the far end is gone.
        """
        while (piece := self._read_piece()) is not None:
            answer = self._reader.feed(*piece)
            if answer is not None:
                return self._check(answer, expected)
        return None

    def check_silent(self) -> None:
        """Check that the socket holds no unrequested data.

        Raises:
            PolicyFailed: protocol_violation.
        """
        try:
            waiting = self._sock.recv(1, _PEEK)
        except (BlockingIOError, ConnectionResetError):
            waiting = b""
        if waiting or not self._reader.is_empty:
            raise violation("Received a second answer to one question, expected exactly one.")

    def has_unread_question(self) -> bool:
        """Return whether a part of a question was never read; the next reader would get it."""
        unread = bytearray(4)
        fcntl.ioctl(self._sock, termios.TIOCOUTQ, unread)
        return bool(self._unsent) or any(unread)

    def reset(self) -> None:
        """Drop an unfinished exchange and count questions from one; every process that could send has ended."""
        self._unsent = []
        self._seq = 0
        self._reader = FrameReader(message_bytes=self._reader.message_bytes)
        drain(self._sock)

    def close(self) -> None:
        """Close this end."""
        self._sock.close()

    def _check(self, answer: PolicyAnswer, expected: Sequence[AnswerKind]) -> PolicyAnswer:
        if self._unsent:
            raise violation("Received an answer before the policy had read the whole question.")
        if answer.header.seq != self._seq:
            raise violation(f"Expected the answer to question {self._seq}, got that to question {answer.header.seq}.")
        if answer.header.kind not in expected:
            raise violation(f"Expected an answer {' or '.join(expected)}, got {answer.header.kind!s}.")
        self.check_silent()
        return answer

    def _read_piece(self) -> tuple[bytes, int] | None:
        try:
            # Room for the sender's credentials and nothing else: descriptors that a policy passes along find no place.
            data, ancillary, flags, _ = self._sock.recvmsg(_CHUNK_BYTES, socket.CMSG_SPACE(_CREDENTIALS_BYTES))
        except BlockingIOError:
            return None
        except ConnectionResetError:
            data, ancillary, flags = b"", [], 0
        if flags & _CUT_OFF:
            raise violation("A message carried more than bytes (such as file descriptors).")
        if not data:
            raise ChannelClosed("The policy's end of the channel was closed before it answered.")
        return data, _sender_pid(ancillary)


class ChannelClosed(Exception):
    """The far end closed the channel; the session looks at how the process ended and names the verdict."""


def drain(sock: socket.socket) -> None:
    """Discard all unread data of a socket."""
    try:
        while sock.recv(_CHUNK_BYTES, _DO_NOT_WAIT):
            pass
    except (BlockingIOError, ConnectionResetError):
        return


def _unsent_parts(parts: list[memoryview], sent: int) -> list[memoryview]:
    rest = []
    for part in parts:
        skip = min(sent, part.nbytes)
        sent -= skip
        if skip < part.nbytes:
            rest.append(part[skip:])
    return rest


def _sender_pid(ancillary: list[tuple[int, int, bytes]]) -> int:
    """Return the process that has sent a piece, 0 where the system does not say."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_CREDENTIALS:
            return array.array("i", data[:_CREDENTIALS_BYTES])[0]
    return 0
