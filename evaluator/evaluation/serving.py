"""A policy server in front of one's own folder, image or server of LeRobot; `vitac remote connect` asks it.

It speaks the protocol of vla-eval's model servers, which says where an episode begins and ends.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from typing import Any, Final

from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from ..agent.verdicts import EpisodeCut, PolicyFailed
from ..episodes.episode import Session
from ..remote.codec import decode, encode, read_value
from ..remote.protocols import VLA_EVAL_VERSION
from ..tracks import Track

_HOST: Final = "127.0.0.1"

Message = tuple[str, Mapping[str, Any], int]
"""Its type, payload and number."""


Load = Callable[[], AbstractContextManager[Session]]
"""Gives what asks the policy, once for each line."""


@contextmanager
def served(track: Track, load: Load) -> Iterator[str]:
    """Serve a policy while the block runs, and return the address of this machine.

    Args:
        track: that it plays.
        load: gives what asks it.
    """
    answer = partial(_answer, track=track, load=load)
    with serve(answer, _HOST, 0, compression=None, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever, name="policy-server", daemon=True)
        thread.start()
        try:
            yield f"ws://{_HOST}:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join()


def _answer(connection: ServerConnection, *, track: Track, load: Load) -> None:
    """Play the episodes of one line; it ends with an episode that was cut."""
    messages = _read_messages(connection)
    name, _, seq = next(messages, ("", {}, 0))
    if name != "hello":
        return
    _send(connection, "hello", {"protocol_version": VLA_EVAL_VERSION, "server_name": "vitac"}, seq)
    try:
        with suppress(EpisodeCut), load() as session:
            for name, payload, _ in messages:
                if name == "episode_start":
                    session.begin_shard()  # the limit of a shard's time holds at the service
                    _play(connection, messages, session, track.task(payload["task"]["name"]).name, track)
    except PolicyFailed as failed:
        question = next((seq for name, _, seq in messages if name == "observation"), None)
        if question is not None:
            _send(connection, "error", {"error": failed.message}, question)


def _play(connection: ServerConnection, messages: Iterator[Message], session: Session, task: str, track: Track) -> None:
    action_shape = (len(track.task(task).actions),)
    try:
        with session.episode(task=task, action_shape=action_shape) as policy:
            for name, payload, seq in messages:
                if name != "observation":
                    return
                seen = {key: value for key, value in payload.items() if key != "task_description"}
                observation = dict(_read_observation(seen))
                _send(connection, "action", {"actions": policy.act(observation)}, seq)
    except PolicyFailed as failed:
        _send(connection, "error", {"error": failed.message}, 0)


def _read_messages(connection: ServerConnection) -> Iterator[Message]:
    try:
        for data in connection:
            message = decode(data if isinstance(data, bytes) else data.encode())
            yield message["type"], message["payload"], message["seq"]
    except ConnectionClosed:
        return


def _read_observation(levels: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the values of an observation by name; a level of the message is a slash in it."""
    for name, value in levels.items():
        if isinstance(value, Mapping) and not {"__ndarray__", "__image__"} & value.keys():
            yield from _read_observation(value, f"{above}{name}/")
        else:
            yield f"{above}{name}", read_value(value)


def _send(connection: ServerConnection, name: str, payload: Mapping[str, Any], seq: int) -> None:
    connection.send(encode({"type": name, "payload": payload, "seq": seq}, binary_keys=False))
