"""Stands in for LeRobot's policy server: its classes and torch's by their names, and the methods that it serves."""

import io
import pickle
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent import futures
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import grpc
import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.evaluator.remote.lerobot import _field, _read_field


@dataclass
class RemotePolicyConfig:
    policy_type: str
    pretrained_name_or_path: str
    lerobot_features: dict[str, Any]
    actions_per_chunk: int
    device: str = "cpu"


@dataclass
class TimedObservation:
    timestamp: float
    timestep: int
    observation: dict[str, Any]
    must_go: bool = False


@dataclass
class TimedAction:
    timestamp: float
    timestep: int
    action: Any


def _rebuild_tensor_v2(*_: object) -> None: ...
def _load_from_bytes(_: object) -> None: ...


class FloatStorage: ...


class BFloat16Storage: ...


class _Storage:
    """What torch writes of a storage: five pickles, a count and the numbers."""

    def __init__(self, numbers: NDArray[Any], kind: type, padding: int) -> None:
        self._numbers, self._kind, self._padding = numbers, kind, padding

    def __reduce__(self) -> tuple[Any, ...]:
        stream = io.BytesIO()
        for value in (0x1950A86A20F9469CFC6C, 1001, [True] * self._padding, self, ["7"]):
            pickler = pickle.Pickler(stream, protocol=2)
            pickler.persistent_id = self._identity  # type: ignore[method-assign]
            pickler.dump(value)
        stream.write(np.int64(len(self._numbers)).tobytes() + self._numbers.tobytes())
        return _load_from_bytes, (stream.getvalue(),)

    def _identity(self, value: object) -> object:
        return ("storage", self._kind, "7", "cpu", len(self._numbers), None) if value is self else None


class Tensor:
    """A row of a chunk, as torch pickles it."""

    def __init__(self, numbers: Any, row: int = 0, kind: type = FloatStorage, padding: int = 0) -> None:
        self._numbers, self._row, self._kind = np.atleast_2d(np.asarray(numbers, np.float32)), row, kind
        self._padding = padding

    def __reduce_ex__(self, _: object) -> tuple[Any, ...]:
        width = self._numbers.shape[1]
        storage = _Storage(self._numbers.ravel(), self._kind, self._padding)
        return _rebuild_tensor_v2, (storage, self._row * width, (width,), (1,), False, OrderedDict())


NAMES = {
    "lerobot.async_inference.helpers": (RemotePolicyConfig, TimedObservation, TimedAction),
    "torch": (FloatStorage, BFloat16Storage),
    "torch._utils": (_rebuild_tensor_v2,),
    "torch.storage": (_load_from_bytes,),
}


@pytest.fixture
def lerobot_names(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the classes be pickled under the names that they have in LeRobot and torch."""
    for name in ("lerobot", "lerobot.async_inference", *NAMES):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    for module, members in NAMES.items():
        for member in members:
            monkeypatch.setattr(member, "__module__", module)
            monkeypatch.setattr(sys.modules[module], member.__name__, member, raising=False)


def chunk(numbers: Any, timestep: int) -> bytes:
    """An answer of the server: a row for each action."""
    rows = range(len(np.atleast_2d(numbers)))
    return pickle.dumps([TimedAction(0.0, timestep + row, Tensor(numbers, row)) for row in rows])


Answer = Callable[[TimedObservation], bytes]


@contextmanager
def lerobot_serving(answer: Answer, heard: list[Any] | None = None) -> Iterator[str]:
    """Serves on a free port of this machine; notes what it is told in `heard`, and gives the address."""
    noted: list[Any] = [] if heard is None else heard
    waiting: list[TimedObservation] = []

    def ready(_request: bytes, _context: object) -> bytes:
        noted.append("Ready")
        return b""

    def load(request: bytes, _context: object) -> bytes:
        noted.append(pickle.loads(_read_field(request)))  # noqa: S301 - as LeRobot does
        return b""

    def observe(messages: Iterator[bytes], _context: object) -> bytes:
        pieces = list(messages)
        states = [piece[1] for piece in pieces]
        assert states == [*[1, *[2] * (len(pieces) - 2)][: len(pieces) - 1], 3]
        data = b"".join(_read_field(b"\x0a" + piece[3:]) for piece in pieces)
        observation = pickle.loads(data)  # noqa: S301 - as LeRobot does
        noted.append(observation)
        waiting.append(observation)
        return b""

    def act(_request: bytes, _context: object) -> bytes:
        actions = answer(waiting.pop())
        return _field(1, actions) if actions else b""

    unary = grpc.unary_unary_rpc_method_handler
    methods = {
        "Ready": unary(ready),
        "SendPolicyInstructions": unary(load),
        "SendObservations": grpc.stream_unary_rpc_method_handler(observe),
        "GetActions": unary(act),
    }
    server = grpc.server(futures.ThreadPoolExecutor(2))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("transport.AsyncInference", methods),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"grpc://127.0.0.1:{port}"
    finally:
        server.stop(0).wait()
