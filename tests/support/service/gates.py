"""A gate for policies that dial in, on free ports; its tokens are `of TEAM`, or those of a database."""

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.operations.remote_gate import Gate, run_gate


def find_team(secret: str) -> str:
    if secret.startswith("of "):
        return secret.removeprefix("of ")
    raise ServiceError(ProblemCode.INVALID_CREDENTIALS, "Expected a token, got another form.")


@contextmanager
def gate(wait_s: float = 10.0, find: Callable[[str], str] = find_team) -> Iterator[tuple[str, str]]:
    """A gate on two ports; gives the addresses for policies and for players."""
    loop = asyncio.new_event_loop()
    stop = asyncio.Event()
    policies, players = socket.create_server(("127.0.0.1", 0)), socket.create_server(("127.0.0.1", 0))
    ports = [listener.getsockname()[1] for listener in (policies, players)]
    task = run_gate(Gate(find, wait_s), policies=policies, players=players, stop=stop)
    thread = threading.Thread(target=loop.run_until_complete, args=(task,))
    thread.start()
    try:
        yield f"ws://127.0.0.1:{ports[0]}", f"ws://127.0.0.1:{ports[1]}"
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()
        loop.close()
