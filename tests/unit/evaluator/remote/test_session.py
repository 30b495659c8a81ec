import itertools
import socket
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_fakes import FakeEnvironment, small_track, succeed
from policy_servers import ACTION, Handler, openpi, packed, serving, vla_eval
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.remote.codec import decode
from vitac.evaluator.remote.description import RemoteServer
from vitac.evaluator.remote.line import AddressInvalid
from vitac.evaluator.remote.session import RemoteSession
from vitac.evaluator.shards.order import ShardEnd
from vitac.evaluator.shards.policy import run_shard
from vitac.evaluator.tracks.definition import cut
from websockets.exceptions import ConnectionClosed
from websockets.server import ServerProtocol
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

LIMITS = Limits(start_wall_s=1.0, action_wall_s=0.4)
TRACK = small_track()
TASK = TRACK.tasks["peg-insertion"]
OBSERVATION = {"relative_motion": np.zeros(4, np.float32)}


def session(address: str, limits: Limits = LIMITS, **server: Any) -> RemoteSession:
    """What plays with a server of openpi's protocol."""
    return RemoteSession(address, RemoteServer.model_validate({"protocol": "openpi", **server}), limits)


def act(address: str, seen: Sequence[Any] = (OBSERVATION,), **server: Any) -> list[list[float]]:
    """The actions of an episode."""
    with session(address, **server) as opened, opened.episode(task="peg-insertion", action_shape=(3,)) as policy:
        return [policy.act(observation).tolist() for observation in seen]


def play(handler: Handler, **server: Any) -> tuple[ShardEnd, list[EpisodeRecord]]:
    """Plays the twelve episodes of the small list with a server."""
    records: list[EpisodeRecord] = []
    with serving(handler) as address:
        ends = [
            run_shard(
                submission_dir=Path("unused"),
                track=TRACK,
                task=TASK,
                shard=shard,
                on_episode=records.append,
                load_policy=lambda *_: session(address, Limits(action_wall_s=5.0), **server),
                make_env=lambda *_: FakeEnvironment(),
            ).end
            for shard in cut(TASK)
        ]
    assert len(set(ends)) == 1
    return ends[0], sorted(records, key=lambda record: record.episode)


def answer(question: dict[Any, Any]) -> np.ndarray[Any, Any]:
    """The action of the stand-in for policies, which solves the task at the third env step."""
    motion = np.frombuffer(question["relative_motion"][b"data"], np.float32)
    return succeed(0, 1 + int(motion[3]))


def with_actions(actions: object) -> Handler:
    return openpi(lambda _: packed({"actions": actions}))


def digests(records: list[EpisodeRecord]) -> list[str]:
    return [record.record_digest() for record in records]


def test_horizon_of_one_gives_the_records_of_one_by_one_play() -> None:
    one_by_one = play(openpi(lambda question: packed({"actions": answer(question)})))
    chunks = play(openpi(lambda question: packed({"actions": np.stack([answer(question), -ACTION])})))
    assert one_by_one[0] is ShardEnd.COMPLETE
    assert [record.env_steps for record in one_by_one[1]] == [3] * 12
    assert digests(one_by_one[1]) == digests(chunks[1])


def test_two_actions_of_each_answer_are_played_before_the_next_question() -> None:
    questions: list[int] = []

    def two(question: dict[Any, Any]) -> bytes:
        questions.append(1)
        return packed({"actions": np.stack([answer(question), answer(question), ACTION])})

    _, records = play(openpi(two), execute=2)
    assert [record.env_steps for record in records] == [3] * 12  # asked at 0 and 2; the third action is never played
    assert len(questions) == 24


def test_thirty_cuts_of_the_line_change_no_record() -> None:
    honest = play(openpi(lambda question: packed({"actions": answer(question)})))[1]
    random, cuts = np.random.default_rng(0), itertools.count(1)
    cuts_of_episode = [0]

    def cutting(connection: ServerConnection) -> None:
        connection.send(packed({}))
        for message in connection:
            assert isinstance(message, bytes)
            action = answer(decode(message))
            if cuts_of_episode[0] < 2 and random.random() < 0.6 and next(cuts) <= 30:
                cuts_of_episode[0] += 1
                connection.socket.shutdown(socket.SHUT_RDWR)
                return
            if action[0] == 1:  # the last one of the episode
                cuts_of_episode[0] = 0
            connection.send(packed({"actions": action}))

    records = [play(cutting)[1] for _ in range(2)]
    assert next(cuts) > 30
    assert [digests(each) for each in records] == [digests(honest)] * 2


def test_line_that_is_always_cut_ends_with_a_verdict() -> None:
    def cut_at_once(connection: ServerConnection) -> None:
        connection.send(packed({}))
        connection.recv()

    end, records = play(cut_at_once)
    assert end is ShardEnd.BROKEN
    assert {record.failure.code for record in records if record.failure} == {VerdictCode.LINE_LOST}


def test_vla_eval_hears_of_both_ends_of_an_episode() -> None:
    heard: list[dict[Any, Any]] = []
    with serving(vla_eval(lambda _: {}, heard=heard)) as address, session(address, protocol="vla-eval") as opened:
        for _ in range(2):
            with opened.episode(task="peg-insertion", action_shape=(3,)) as policy:
                assert policy.act(OBSERVATION).tolist() == [1, 0, 0]
    types = [message["type"] for message in heard]
    assert types == ["hello", *["episode_start", "observation", "episode_end"] * 2]


def test_slash_in_a_name_makes_a_level_for_vla_eval() -> None:
    heard: list[dict[Any, Any]] = []
    with serving(vla_eval(lambda _: {}, heard=heard)) as address:
        names = {"images/wrist": "relative_motion"}
        act(address, protocol="vla-eval", observations=names, prompt="Insert the peg.")
    observation = heard[2]["payload"]
    assert observation["task_description"] == "Insert the peg."
    assert observation["images"].keys() == {"wrist"}


def free_address() -> str:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return f"ws://127.0.0.1:{sock.getsockname()[1]}"


def dialling(address: str, policy: Callable[[Any], None]) -> threading.Thread:
    """Dials the robot's end of the bridge until it answers, in a thread."""

    def dial() -> None:
        while True:
            try:
                with connect(address, compression=None) as connection:
                    policy(connection)
                return
            except ConnectionClosed:
                return
            except OSError:
                time.sleep(0.01)

    thread = threading.Thread(target=dial)
    thread.start()
    return thread


def greet(connection: Any) -> None:
    assert decode(connection.recv()) == {"type": "hello", "protocol": "robot-bridge-v1"}
    connection.send(packed({"type": "config", "config": {"action_horizon": 50, "steps_per_inference": 2}}))


def test_policy_of_the_2026_edition_dials_warms_up_and_plays() -> None:
    sequence: list[int] = []

    def policy(connection: Any) -> None:
        greet(connection)
        sequence.append(decode(connection.recv())["obs_seq"])
        connection.send(packed({"type": "state", "state": "start"}))
        for data in connection:
            message = decode(data)
            sequence.append(message["obs_seq"])
            assert message["obs"]["task"] == "peg-insertion"
            chunk = np.stack([ACTION] * 50)
            connection.send(packed({"type": "action", "obs_seq": message["obs_seq"], "action": chunk}))

    address = free_address()
    thread = dialling(address, policy)
    assert act(address, [OBSERVATION] * 4, protocol="robot-bridge", execute=2) == [[1, 0, 0]] * 4
    thread.join()
    assert sequence == [1, 2, 3]


def test_second_policy_finds_nobody_to_dial_while_the_first_plays() -> None:
    address, refusals = free_address(), []

    def policy(connection: Any) -> None:
        greet(connection)
        connection.recv()
        connection.send(packed({"type": "state", "state": "start"}))
        with pytest.raises(ConnectionRefusedError) as refused, connect(address, compression=None, open_timeout=1):
            pass
        refusals.append(refused.value)
        for data in connection:
            connection.send(packed({"type": "action", "obs_seq": decode(data)["obs_seq"], "action": ACTION}))

    thread = dialling(address, policy)
    assert act(address, [OBSERVATION] * 2, protocol="robot-bridge") == [[1, 0, 0]] * 2
    thread.join()
    assert len(refusals) == 1


def flood_of_starts(connection: Any) -> None:
    greet(connection)
    while True:
        connection.send(packed({"type": "state", "state": "start"}))


def old_answers(connection: Any) -> None:
    greet(connection)
    connection.recv()
    connection.send(packed({"type": "state", "state": "start"}))
    connection.recv()
    while True:
        connection.send(packed({"type": "action", "obs_seq": 1, "action": ACTION}))


@pytest.mark.parametrize(
    ("policy", "verdict"), [(flood_of_starts, VerdictCode.WALL_TIME), (old_answers, VerdictCode.PROTOCOL_VIOLATION)]
)
def test_hostile_policy_on_the_bridge_ends_within_its_limit(policy: Any, verdict: VerdictCode) -> None:
    address = free_address()
    thread = dialling(address, policy)
    started_s = time.monotonic()
    with pytest.raises(PolicyFailed) as failure:
        act(address, protocol="robot-bridge")
    thread.join()
    assert failure.value.verdict is verdict
    assert time.monotonic() - started_s < 2 * LIMITS.start_wall_s + 1


def say_nothing(connection: ServerConnection) -> None:
    connection.send(packed({}))
    for _ in connection:
        pass


def answer_twice(connection: ServerConnection) -> None:
    connection.send(packed({}))
    for _ in connection:
        connection.send(packed({"actions": ACTION}))
        connection.send(packed({"actions": ACTION}))


def answer_slowly(connection: ServerConnection) -> None:
    connection.send(packed({}))
    for _ in connection:
        for byte in b"\x82\x7e\x01\x00" + bytes(256):
            connection.socket.sendall(bytes([byte]))
            time.sleep(0.05)


def flood(connection: ServerConnection) -> None:
    connection.send(packed({}))
    while True:
        connection.send(packed({"actions": ACTION}))


def ping_for_ever(connection: ServerConnection) -> None:
    connection.send(packed({}))
    while True:
        connection.ping()


def fragment_for_ever(connection: ServerConnection) -> None:
    connection.send(packed({}))
    connection.recv()
    connection.send(itertools.repeat(bytes(2**16)))


def speak_no_websocket(connection: ServerConnection) -> None:
    connection.send(packed({}))
    connection.socket.sendall(b"\xff" * 100)
    time.sleep(0.2)


DEEP = b"\x81\xa7actions" + b"\x91" * 100_000 + b"\xc0"


@pytest.mark.parametrize(
    ("handler", "verdict", "words"),
    [
        (say_nothing, VerdictCode.WALL_TIME, "longer than 1 s"),
        (answer_slowly, VerdictCode.WALL_TIME, "longer than 1 s"),
        (ping_for_ever, VerdictCode.WALL_TIME, "longer than 1 s"),
        (fragment_for_ever, VerdictCode.PROTOCOL_VIOLATION, "at most 1048576 bytes"),
        (speak_no_websocket, VerdictCode.PROTOCOL_VIOLATION, "Expected a websocket"),
        (openpi(lambda _: bytes(2**20 + 1)), VerdictCode.PROTOCOL_VIOLATION, "at most 1048576 bytes"),
        (openpi(lambda _: DEEP), VerdictCode.PROTOCOL_VIOLATION, "MessagePack"),
        (openpi(lambda _: packed({"no": 1})), VerdictCode.PROTOCOL_VIOLATION, "field 'actions'"),
        (openpi(lambda _: "Traceback:\nValueError: no GPU"), VerdictCode.CRASHED, "ValueError: no GPU"),
        (with_actions(np.full(3, np.nan)), VerdictCode.NON_FINITE_ACTION, "NaN|nan"),
        (with_actions(np.full(3, 1e300)), VerdictCode.NON_FINITE_ACTION, "float32"),
        (with_actions(np.zeros(4)), VerdictCode.BAD_ACTION_SHAPE, r"shape \(4,\), expected \(3,\)"),
        (with_actions(np.zeros((0, 3))), VerdictCode.BAD_ACTION_SHAPE, "expected 1 or more"),
        (with_actions(np.zeros((1, 1, 3))), VerdictCode.BAD_ACTION_SHAPE, "expected 1 or more"),
        (with_actions("no"), VerdictCode.BAD_ACTION_TYPE, "array of numbers"),
    ],
)
def test_hostile_server_ends_with_a_sentence_and_within_its_limit(
    handler: Handler, verdict: VerdictCode, words: str
) -> None:
    started_s = time.monotonic()
    with serving(handler) as address, pytest.raises(PolicyFailed, match=words) as failure:
        act(address)
    assert failure.value.verdict is verdict
    assert time.monotonic() - started_s < 2 * LIMITS.start_wall_s + 1


@pytest.mark.parametrize("handler", [answer_twice, flood])
def test_second_answer_to_one_question_is_never_played(handler: Handler) -> None:
    with serving(handler) as address, pytest.raises(PolicyFailed, match="second answer"):
        act(address, [OBSERVATION] * 100)


@pytest.mark.parametrize(
    ("handler", "words"),
    [
        (vla_eval(lambda seq: {"seq": seq - 1}), "Expected the answer to question 3, got that to question 2"),
        (vla_eval(lambda _: {"type": "hello"}), "Expected the message 'action', got 'hello'"),
        (vla_eval(lambda _: {"payload": [1]}), "Expected a payload that is a map"),
        (vla_eval(lambda _: {"type": "error", "payload": {"error": "predict: no GPU"}}), "reported an error.*no GPU"),
        (vla_eval(lambda _: {}, version=2), "protocol version 1, got 2"),
    ],
)
def test_hostile_model_server_of_vla_eval_ends_with_a_sentence(handler: Handler, words: str) -> None:
    with serving(handler) as address, pytest.raises(PolicyFailed, match=words):
        act(address, protocol="vla-eval")


def test_server_that_stops_to_read_holds_nobody_longer_than_its_limit() -> None:
    released = threading.Event()

    large = {"rgb": np.zeros((4000, 4000), np.uint8)}
    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=_shake_hands_and_stop, args=(listener, released), daemon=True).start()
        with pytest.raises(PolicyFailed, match="longer than 1 s"):
            act(f"ws://127.0.0.1:{listener.getsockname()[1]}", [large])
        released.set()


def _shake_hands_and_stop(listener: socket.socket, released: threading.Event) -> None:
    sock, _ = listener.accept()
    with sock:
        protocol = ServerProtocol()
        protocol.receive_data(sock.recv(65536))
        protocol.send_response(protocol.accept(protocol.events_received()[0]))  # type: ignore[arg-type]
        protocol.send_binary(packed({}))
        for data in protocol.data_to_send():
            sock.sendall(data)
        released.wait(10)


def test_server_that_starts_late_is_waited_for() -> None:
    address = free_address()
    port = int(address.rpartition(":")[2])
    started = threading.Event()

    def start_late() -> None:
        time.sleep(0.4)
        with serve(with_actions(ACTION), "127.0.0.1", port, compression=None) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            started.wait(5)

    thread = threading.Thread(target=start_late)
    thread.start()
    assert act(address) == [[1, 0, 0]]
    started.set()
    thread.join()


def test_absent_server_is_named() -> None:
    address = free_address()
    with pytest.raises(PolicyFailed, match=f"No policy server answered at {address}: .*refused") as failure:
        act(address)
    assert failure.value.verdict is VerdictCode.LINE_LOST


@pytest.mark.parametrize("address", ["", "127.0.0.1:8000", "http://127.0.0.1", "ws://", "ws://host:port"])
def test_address_of_something_else_is_refused(address: str) -> None:
    with pytest.raises(AddressInvalid, match="Expected an address such as ws://"):
        session(address)
