"""Policy servers that stand in for those of a participant: well-behaved ones, and whatever a handler does."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from vitac.evaluator.remote.codec import decode, encode
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

Handler = Callable[[ServerConnection], None]
ACTION = np.array([1, 0, 0], np.float32)


@contextlib.contextmanager
def serving(handler: Handler) -> Iterator[str]:
    """Serves on a free port of this machine; gives the address."""

    def until_closed(connection: ServerConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            handler(connection)

    with serve(until_closed, "127.0.0.1", 0, max_size=None, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            server.shutdown()
            thread.join()


def packed(message: dict[str, Any]) -> bytes:
    """A message as openpi and the bridge write it."""
    return encode(message, binary_keys=True)


def openpi(answer: Callable[[dict[Any, Any]], bytes | str]) -> Handler:
    """Speaks as openpi's server does, with the given answers."""

    def handle(connection: ServerConnection) -> None:
        connection.send(packed({}))
        for message in connection:
            assert isinstance(message, bytes)
            connection.send(answer(decode(message)))

    return handle


def vla_eval(
    answer: Callable[[int], dict[str, Any]], version: int = 1, heard: list[dict[Any, Any]] | None = None
) -> Handler:
    """Speaks as vla-eval's model server does; an answer may replace any field, and each message is noted in `heard`."""

    def handle(connection: ServerConnection) -> None:
        for data in connection:
            assert isinstance(data, bytes)
            message = decode(data)
            if heard is not None:
                heard.append(message)
            kind, seq = message["type"], message["seq"]
            reply: dict[str, Any] = {"seq": seq, "timestamp": 0.0}
            if kind == "hello":
                connection.send(packed(reply | {"type": "hello", "payload": {"protocol_version": version}}))
            elif kind == "observation":
                connection.send(packed(reply | {"type": "action", "payload": {"actions": ACTION}} | answer(seq)))

    return handle
