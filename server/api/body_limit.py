"""Bounds the bodies of all requests but uploads, which have a limit of their own."""

from collections.abc import Collection

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LIMIT_BYTES = 64 * 1024
TOO_LARGE = 413


class BodyLimit:
    """ASGI middleware. A body that is too large is never held in memory: the request ends with 413 as it shows.

    `unlimited` names methods and paths, or paths up to their last slash, that count for themselves.
    """

    def __init__(self, app: ASGIApp, unlimited: Collection[tuple[str, str]], limit_bytes: int = LIMIT_BYTES) -> None:
        self._app = app
        self._unlimited = frozenset(unlimited)
        self._limit_bytes = limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on with a body that is counted while it is read."""
        if scope["type"] != "http" or self._is_unlimited(scope):
            await self._app(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self._limit_bytes:
                raise HTTPException(TOO_LARGE, f"A body may have at most {self._limit_bytes} bytes here; it has more.")
            return message

        await self._app(scope, counted, send)

    def _is_unlimited(self, scope: Scope) -> bool:
        path: str = scope["path"]
        return not self._unlimited.isdisjoint({(scope["method"], path), (scope["method"], path[: path.rfind("/") + 1])})
