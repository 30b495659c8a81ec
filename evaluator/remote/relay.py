"""Joins two open websockets into one line, message by message; the gate and `vitac remote connect` do so."""

import asyncio
from contextlib import suppress
from urllib.parse import quote

from websockets.asyncio.connection import Connection
from websockets.exceptions import ConnectionClosed

WAITING = "waiting"
"""What the gate says to a line that it keeps."""
BEGIN = "begin"
"""What it says when somebody plays on it; all that follows is the policy server's protocol."""

PLAY = "/play/"
"""How paths at the gate's inner address begin, before the name of a team."""


def inner_address(gate: str, team: str) -> str:
    """Return where a team's policy is asked that has dialled the gate of an inner address."""
    return f"{gate.rstrip('/')}{PLAY}{quote(team, safe='')}"


async def join(one: Connection, other: Connection) -> None:
    """Send what comes from either end to the other, until one is closed; then both are."""
    copies = [asyncio.create_task(_copy(*ends)) for ends in ((one, other), (other, one))]
    try:
        await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for copy in copies:
            copy.cancel()
        await asyncio.gather(*copies, one.close(), other.close(), return_exceptions=True)


async def _copy(source: Connection, target: Connection) -> None:
    with suppress(ConnectionClosed):
        async for message in source:
            await target.send(message)
