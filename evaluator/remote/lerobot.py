"""LeRobot's asynchronous inference: its policy server over gRPC, asked one question at a time; called by `protocols`.

Messages are those of its transport/services.proto, written here by hand: fields of bytes, and a number.
"""

import secrets
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final
from urllib.parse import urlsplit

import grpc
import numpy as np
from numpy.typing import NDArray

from ..agent.protocol import violation
from .codec import ANSWER_BYTES
from .description import RemoteServer
from .line import LineLost, LineSilent, reported
from .pickles import read_actions, write_call

_SERVICE: Final = "/transport.AsyncInference/"
_CHUNK_BYTES: Final = 2 * 1024 * 1024
"""LeRobot's own; its server takes messages of 4 MiB."""
_BEGIN, _MIDDLE, _END = 1, 2, 3
_BYTES: Final = 2
"""Wire type of a field of bytes (Protocol Buffers, encoding)."""
_IMAGES: Final = "observation.images."
_STATE: Final = "observation.state"


class LeRobot:
    """What both ends say: the server loads the policy that it is given, and answers each observation with actions.

    Every observation is one that must be answered (`must_go`), so that the server leaves none out.

    Args:
        address: `grpc://HOST:PORT`.
        server: what submission.yaml says of it, with the policy that it is to load.
        deadline_s: by the monotonic clock; the server may be starting.

    Raises:
        LineLost: nobody answered.
    """

    def __init__(self, address: str, server: RemoteServer, deadline_s: float) -> None:
        self._server = server
        self._features: Mapping[str, object] = {}
        self._timestep = secrets.randbelow(2**30)  # another client's questions have other numbers
        options = [("grpc.max_receive_message_length", ANSWER_BYTES), ("grpc.enable_http_proxy", 0)]
        self._channel = grpc.insecure_channel(urlsplit(address).netloc, options)
        try:
            grpc.channel_ready_future(self._channel).result(timeout=_left_s(deadline_s))
        except grpc.FutureTimeoutError as error:
            self.close()
            raise LineLost(f"No policy server of LeRobot answered at {address}.") from error

    def greet(self, deadline_s: float) -> None:
        """Have the server forget earlier questions."""
        self._call("Ready", b"", deadline_s)

    def begin(self, prompt: str, deadline_s: float) -> None:  # noqa: ARG002 - each question has it
        """Do so again: its protocol has no episodes."""
        self.greet(deadline_s)

    def ask(self, sent: Mapping[str, NDArray[Any]], prompt: str, deadline_s: float) -> object:
        """Send an observation with its prompt; return the actions, shape [actions, components].

        Pictures, arrays of bytes of three axes, are sent under their names; all else is the state, one after the other.
        """
        features, raw = describe(sent)
        if features != self._features:
            self._load(features, deadline_s)
        self._timestep += 1
        observation = write_call("TimedObservation", time.time(), self._timestep, raw | {"task": prompt}, True)
        self._call("SendObservations", _in_chunks(observation), deadline_s)
        actions = _read_field(self._call("GetActions", b"", deadline_s))
        if not actions:
            raise reported("LeRobot's server gave no actions; its log says why")
        return read_actions(actions, self._timestep)

    def end(self, deadline_s: float) -> None:
        """Do nothing: its protocol has no episodes."""

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()

    def _load(self, features: Mapping[str, object], deadline_s: float) -> None:
        """Have the server load the policy, for observations with these features."""
        policy = self._server.policy
        assert policy is not None  # noqa: S101 - the manifest is refused without it
        execute = self._server.execute
        setup = write_call("RemotePolicyConfig", policy.type, policy.path, features, execute, policy.device)
        self._call("SendPolicyInstructions", _field(1, setup), deadline_s)
        self._features = features

    def _call(self, method: str, request: bytes | Iterable[bytes], deadline_s: float) -> bytes:
        """Call a method of the server; requests and answers are the bytes of messages.

        Raises:
            LineLost, LineSilent: the server is gone, or does not answer.
            PolicyFailed: crashed, or protocol_violation.
        """
        is_stream = not isinstance(request, bytes)
        make = self._channel.stream_unary if is_stream else self._channel.unary_unary
        try:
            answer: bytes = make(_SERVICE + method)(request, timeout=_left_s(deadline_s))
        except grpc.RpcError as error:
            raise _read_error(error) from error
        return answer


def describe(sent: Mapping[str, NDArray[Any]]) -> tuple[dict[str, object], dict[str, object]]:
    """Return an observation's features as LeRobot's data sets have them, and the observation as its robots give it.

    Args:
        sent: values by name; those of pictures may begin with `observation.images.`.
    """
    pictures = {name: value for name, value in sent.items() if value.dtype == np.uint8 and value.ndim == 3}
    numbers = [np.ravel(value) for name, value in sent.items() if name not in pictures]
    state = np.concatenate(numbers).tolist() if numbers else []
    names = [f"state_{place}" for place in range(len(state))]
    features: dict[str, object] = {_STATE: {"dtype": "float32", "shape": (len(state),), "names": names}}
    raw: dict[str, object] = dict(zip(names, state, strict=True))
    for name, value in pictures.items():
        bare = name.removeprefix(_IMAGES)
        features[_IMAGES + bare] = {"dtype": "image", "shape": value.shape, "names": ["height", "width", "channels"]}
        raw[bare] = value
    return features, raw


def _in_chunks(data: bytes) -> Iterator[bytes]:
    """Yield the messages `Observation` that carry a pickle."""
    starts = range(0, len(data), _CHUNK_BYTES)
    for place, start in enumerate(starts):
        state = _END if place == len(starts) - 1 else _MIDDLE if place else _BEGIN
        yield bytes([1 << 3, state]) + _field(2, data[start : start + _CHUNK_BYTES])


def _field(number: int, data: bytes) -> bytes:
    """Return a field of bytes as Protocol Buffers write it."""
    length = bytearray()
    rest = len(data)
    while rest >= 1 << 7:
        length.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes([number << 3 | _BYTES, *length, rest]) + data


def _read_field(message: bytes) -> bytes:
    """Return the bytes of a message's only field, number 1; none where it is left out.

    Raises:
        PolicyFailed: protocol_violation.
    """
    if not message:
        return b""
    length = next((place for place, byte in enumerate(message[1:], 2) if byte < 1 << 7), 0)
    data = message[length:]
    if not length or message[:length] != _field(1, data)[:length]:
        raise violation(f"Expected a message of LeRobot's Actions, got {len(message)} bytes that are none.")
    return data


def _read_error(error: grpc.RpcError) -> Exception:
    code, details = error.code(), str(error.details())
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return LineSilent()
    if code is grpc.StatusCode.RESOURCE_EXHAUSTED:
        return violation(f"Expected an answer of at most {ANSWER_BYTES} bytes, got a longer one: lower `execute`.")
    if code is grpc.StatusCode.UNKNOWN:
        return reported(details)
    return LineLost(f"LeRobot's server ended the line: {code.name}, {details:.200}.")


def _left_s(deadline_s: float) -> float:
    return max(0.0, deadline_s - time.monotonic())
