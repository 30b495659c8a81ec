"""Joins policies that dial in with those who play them, line by line; run by `vitac gate`.

A policy behind a firewall cannot be dialled. So it dials the gate with its team's token (`vitac remote connect`) and
waits. Whoever plays a submission of the team dials the gate's inner address, and both lines become one: every message
of one end is sent to the other, unread.
"""

import asyncio
from collections import defaultdict, deque
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from socket import socket
from typing import Final
from urllib.parse import unquote

from vitac.evaluator.remote.line import BEGIN, PLAY, WAITING, join
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from ..accounts import tokens
from ..database.engine import Database
from ..errors import ProblemCode, ServiceError

LINES_OF_TEAM: Final = 16
"""Lines of a team that may wait."""
WAIT_S: Final = 60.0
"""Time that whoever plays waits for a policy of the team: so long a line may be away before its episode fails."""
LINE_S: Final = 12 * 3600.0
"""Time after which a line is closed; its policy dials again."""
_PONG_S: Final = 5.0
_CLOSE_S: Final = 1.0
_REASON_BYTES: Final = 120
_MESSAGE_BYTES: Final = 64 << 20


class Gate:
    """The lines that wait, by team.

    Args:
        find_team: returns the name of the team of a token.
        wait_s: time that whoever plays waits for a line [s].
    """

    def __init__(self, find_team: Callable[[str], str], wait_s: float = WAIT_S) -> None:
        self._find_team = find_team
        self._wait_s = wait_s
        self._lines: defaultdict[str, deque[ServerConnection]] = defaultdict(deque)
        self._arrived = asyncio.Condition()

    async def hold(self, line: ServerConnection) -> None:
        """Keep the line of a policy until it is closed."""
        header = line.request.headers.get("Authorization", "") if line.request else ""
        try:
            team = await asyncio.to_thread(self._find_team, header.removeprefix("Bearer "))
        except ServiceError as error:
            await line.close(CloseCode.POLICY_VIOLATION, str(error)[:_REASON_BYTES])
            return
        waiting = self._lines[team]
        if len(waiting) >= LINES_OF_TEAM:
            await line.close(CloseCode.TRY_AGAIN_LATER, f"the team has {LINES_OF_TEAM} lines that wait")
            return
        try:
            await line.send(WAITING)
            async with self._arrived:
                waiting.append(line)
                self._arrived.notify_all()
            await asyncio.wait_for(line.wait_closed(), LINE_S)
        except TimeoutError:
            await line.close(CloseCode.GOING_AWAY, "the line was open for long; dial again")
        finally:
            with suppress(ValueError):
                waiting.remove(line)

    async def play(self, player: ServerConnection) -> None:
        """Join whoever plays with a waiting policy of the team that its path names."""
        path = player.request.path if player.request else ""
        line = await self._take(unquote(path.removeprefix(PLAY)))
        if line is None:
            await player.close(CloseCode.TRY_AGAIN_LATER, f"no policy of the team was connected for {self._wait_s:g} s")
            return
        await join(player, line)

    async def _take(self, team: str) -> ServerConnection | None:
        """Return a line that answers and knows that somebody plays; None where there is none in time."""
        waiting = self._lines[team]
        with suppress(TimeoutError):
            async with asyncio.timeout(self._wait_s):
                while True:
                    async with self._arrived:
                        await self._arrived.wait_for(lambda: waiting)
                        line = waiting.popleft()
                    with suppress(ConnectionClosed, TimeoutError):
                        await asyncio.wait_for(await line.ping(), _PONG_S)
                        await line.send(BEGIN)
                        return line
        return None


def find_team(database: Database, secret: str) -> str:
    """Return the name of the team of a token.

    Raises:
        ServiceError: it is none, or of nobody's team.
    """
    with database.transaction() as session:
        principal = tokens.authenticate(session, secret)
    if principal.team_name is None:
        raise ServiceError(ProblemCode.FORBIDDEN, "Expected the token of a team, got another one.")
    return principal.team_name


async def run_gate(gate: Gate, *, policies: socket, players: socket, stop: asyncio.Event) -> None:
    """Listen until `stop` is set.

    Args:
        gate: what joins the lines.
        policies: listening socket that policies dial.
        players: listening socket that server and workers dial; nobody else should reach it.
        stop: ends it.
    """
    async with AsyncExitStack() as stack:
        for handler, listener in ((gate.hold, policies), (gate.play, players)):
            await stack.enter_async_context(
                serve(handler, sock=listener, compression=None, max_size=_MESSAGE_BYTES, close_timeout=_CLOSE_S)
            )
        await stop.wait()
