"""LeRobot's policy server as a stand-in speaks it; tests/integration/remote/test_policy_servers.py has the real one."""

import os
import pickle
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lerobot_server import (
    Answer,
    BFloat16Storage,
    RemotePolicyConfig,
    Tensor,
    TimedAction,
    chunk,
    lerobot_names,
    lerobot_serving,
)
from numpy.typing import NDArray
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.remote.codec import ANSWER_BYTES
from vitac.evaluator.remote.description import RemoteServer
from vitac.evaluator.remote.line import AddressInvalid
from vitac.evaluator.remote.pickles import read_actions
from vitac.evaluator.remote.session import RemoteSession

pytestmark = pytest.mark.usefixtures("lerobot_names")
__all__ = ["lerobot_names"]
POLICY = {"type": "act", "path": "/models/peg", "device": "cuda"}
PICTURE = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
OBSERVATION: dict[str, NDArray[Any]] = {
    "rgb": PICTURE,
    "relative_motion": np.array([1.0, 2.0], np.float32),
    "force": np.array([[3.0]]),
}
CHUNK = np.arange(6, dtype=np.float32).reshape(2, 3) / 8


def session(address: str, **server: Any) -> RemoteSession:
    """What asks a server of LeRobot."""
    described = RemoteServer.model_validate({"protocol": "lerobot", "policy": POLICY, **server})
    return RemoteSession(address, described, Limits(start_wall_s=1.0, action_wall_s=0.5))


def act(address: str, times: int = 1, **server: Any) -> list[list[float]]:
    """The actions of an episode."""
    with session(address, **server) as opened, opened.episode(task="peg-insertion", action_shape=(3,)) as policy:
        return [policy.act(OBSERVATION).tolist() for _ in range(times)]


def test_server_loads_the_policy_once_and_answers_every_observation() -> None:
    heard: list[Any] = []
    with lerobot_serving(lambda observation: chunk(CHUNK, observation.timestep), heard) as address:
        names = {"observation.state": "relative_motion", "f": "force", "observation.images.wrist": "rgb"}
        assert act(address, 4, execute=2, prompt="Insert it.", observations=names) == [*CHUNK.tolist()] * 2
    assert heard[:2] == ["Ready"] * 2
    loaded, *observed = heard[2:]
    assert loaded == RemotePolicyConfig("act", "/models/peg", loaded.lerobot_features, 2, "cuda")
    assert loaded.lerobot_features["observation.state"]["shape"] == (3,)
    assert loaded.lerobot_features["observation.images.wrist"]["shape"] == PICTURE.shape
    assert [each.must_go for each in observed] == [True] * 2
    assert observed[1].timestep == observed[0].timestep + 1
    seen = observed[0].observation
    assert seen["task"] == "Insert it."
    np.testing.assert_array_equal(seen["wrist"], PICTURE)
    assert [seen[name] for name in loaded.lerobot_features["observation.state"]["names"]] == [1.0, 2.0, 3.0]


def test_picture_of_many_messages_arrives_whole() -> None:
    heard: list[Any] = []
    picture = np.random.default_rng(0).integers(0, 256, (1024, 1024, 5), np.uint8)
    with (
        lerobot_serving(lambda observation: chunk(CHUNK, observation.timestep), heard) as address,
        session(address) as opened,
        opened.episode(task="peg-insertion", action_shape=(3,)) as policy,
    ):
        policy.act({"rgb": picture})
    assert (heard[-1].observation["rgb"] == picture).all()


class Attack:
    """Runs a command where it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("touch attacked",)


def slow(_: object) -> bytes:
    time.sleep(2)
    return b""


def crash(_: object) -> bytes:
    raise ValueError("no GPU")


@pytest.mark.parametrize(
    ("answer", "verdict", "words"),
    [
        (lambda _: b"", VerdictCode.CRASHED, "its log says why"),
        (crash, VerdictCode.CRASHED, "no GPU"),
        (slow, VerdictCode.WALL_TIME, "longer than 1 s"),
        (lambda asked: chunk(CHUNK, asked.timestep - 1), VerdictCode.PROTOCOL_VIOLATION, "one client at a time"),
        (lambda _: bytes(ANSWER_BYTES), VerdictCode.PROTOCOL_VIOLATION, "lower `execute`"),
        (lambda asked: chunk(np.full((1, 3), np.nan), asked.timestep), VerdictCode.NON_FINITE_ACTION, "NaN|nan"),
        (lambda asked: chunk(np.zeros((1, 4)), asked.timestep), VerdictCode.BAD_ACTION_SHAPE, r"shape \(4,\)"),
    ],
)
def test_server_that_breaks_a_rule_ends_with_a_sentence(answer: Answer, verdict: VerdictCode, words: str) -> None:
    with lerobot_serving(answer) as address, pytest.raises(PolicyFailed, match=words) as failure:
        act(address)
    assert failure.value.verdict is verdict


def test_server_that_is_away_is_named() -> None:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        address = f"grpc://127.0.0.1:{sock.getsockname()[1]}"
        with pytest.raises(PolicyFailed, match=f"No policy server of LeRobot answered at {address}"):
            act(address)


@pytest.mark.parametrize("address", ["ws://127.0.0.1:1", "grpc://127.0.0.1", "grpc://a/b:1", "grpc://u@h:1"])
def test_address_of_another_kind_is_refused(address: str) -> None:
    with pytest.raises(AddressInvalid, match="such as grpc://"):
        act(address)


def shared_tuples() -> bytes:
    """A tree whose text, hash or comparison would take 2 to the 60th steps."""
    doubled: Any = ()
    for _ in range(60):
        doubled = (doubled, doubled)
    return pickle.dumps([TimedAction(0.0, doubled, doubled)])


def named_by_shared_tuples() -> bytes:
    return shared_tuples().replace(b"\x8c\x0bTimedAction", b"\x8c\x0bTimedActiom")


def long_rows() -> bytes:
    """One storage, which many actions have."""
    row = Tensor(np.zeros(1001))
    return pickle.dumps([TimedAction(0.0, number, row) for number in range(500)])


def long_storage() -> bytes:
    """One storage of many instructions, which each of many actions has."""
    row = Tensor(np.zeros(3), padding=100_000)
    return pickle.dumps([TimedAction(0.0, number, row) for number in range(500)])


@pytest.mark.parametrize(
    "make",
    [
        lambda: pickle.dumps([Attack()]),
        lambda: pickle.dumps([TimedAction(0.0, 0, Attack())]),
        lambda: pickle.dumps([]),
        lambda: pickle.dumps({"actions": [0.0]}),
        lambda: b"no pickle",
        lambda: b"\x80\x04N",
        lambda: b"\x80\x04Nr\xff\xff\xff\xff.",
        lambda: b"\x80\x04" + b"]" * 100_000 + b"a" * 99_999 + b".",
        lambda: b"\x80\x04" + b"N0" * 150_000 + b".",
        lambda: b"\x80\x04(0u.",
        lambda: b"\x80\x04\x94e.",
        shared_tuples,
        named_by_shared_tuples,
        long_rows,
        long_storage,
    ],
)
def test_pickle_that_is_no_answer_is_refused_at_once_and_nothing_of_it_runs(
    make: Callable[[], bytes], tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    data = make()
    started_s = time.monotonic()
    with pytest.raises(PolicyFailed) as failure:
        read_actions(data, 0)
    assert failure.value.verdict is VerdictCode.PROTOCOL_VIOLATION
    assert time.monotonic() - started_s < 5
    assert not list(tmp_path.iterdir())


def test_numbers_of_another_kind_are_named() -> None:
    data = pickle.dumps([TimedAction(0.0, 0, Tensor([1.0], kind=BFloat16Storage))])
    with pytest.raises(PolicyFailed, match="BFloat16Storage") as failure:
        read_actions(data, 0)
    assert failure.value.verdict is VerdictCode.BAD_ACTION_TYPE


@pytest.mark.parametrize(("offset", "size", "stride"), [(1, 3, 1), (-1, 2, 1), (0, 2, 3), (0, 2, -1), (10**30, 1, 0)])
def test_tensor_beyond_its_storage_is_refused(offset: int, size: int, stride: int) -> None:
    class Beyond(Tensor):
        def __reduce_ex__(self, protocol: object) -> tuple[Any, ...]:
            rebuild, (storage, *_, grads, hooks) = super().__reduce_ex__(protocol)
            return rebuild, (storage, offset, (size,), (stride,), grads, hooks)

    with pytest.raises(PolicyFailed, match="in steps of"):
        read_actions(pickle.dumps([TimedAction(0.0, 0, Beyond([1.0, 2.0, 3.0]))]), 0)
