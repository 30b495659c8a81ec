"""Bounds size and time of the bodies of all requests but uploads, which have limits of their own."""

import asyncio
from collections.abc import Collection

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LIMIT_BYTES = 64 * 1024
TOO_LARGE = 413
TOO_SLOW = 408
BODY_TIMEOUT_S = 30.0
"""A body that has not arrived after this time is given up, however steadily it trickles."""


class BodyLimit:
    """ASGI middleware. A body that is too large is never held in memory: it ends with 413, a slow one with 408.

    `unlimited` names methods and paths, or paths up to their last slash, that count for themselves.
    """

    def __init__(self, app: ASGIApp, unlimited: Collection[tuple[str, str]], limit_bytes: int = LIMIT_BYTES) -> None:
        self._app = app
        self._unlimited = frozenset(unlimited)
        self._limit_bytes = limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on with a body that is counted while it is read."""
        if scope["type"] != "http" or matches_route(self._unlimited, scope):
            await self._app(scope, receive, send)
            return
        received, is_complete = 0, False
        deadline = asyncio.get_running_loop().time() + BODY_TIMEOUT_S

        async def counted() -> Message:
            nonlocal received, is_complete
            message = await receive() if is_complete else await _receive_within(deadline, receive)
            received += len(message.get("body", b""))
            is_complete = not message.get("more_body", False)
            if received > self._limit_bytes:
                raise HTTPException(TOO_LARGE, f"A body may have at most {self._limit_bytes} bytes here; it has more.")
            return message

        await self._app(scope, counted, send)


def matches_route(routes: frozenset[tuple[str, str]], scope: Scope) -> bool:
    """Return whether a request has one of these methods and paths, or paths up to their last slash."""
    path: str = scope["path"]
    return not routes.isdisjoint({(scope["method"], path), (scope["method"], path[: path.rfind("/") + 1])})


async def _receive_within(deadline: float, receive: Receive) -> Message:
    try:
        async with asyncio.timeout_at(deadline):
            return await receive()
    except TimeoutError:
        explanation = f"The body was not complete after {BODY_TIMEOUT_S:g} s; send it at once."
        raise HTTPException(TOO_SLOW, explanation, {"Connection": "close"}) from None
