"""Bounds the bodies of all requests but uploads, which have a limit of their own."""

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LIMIT_BYTES = 64 * 1024
TOO_LARGE = 413


class BodyLimit:
    """ASGI middleware. A body that is too large is never held in memory: the request ends with 413 as it shows."""

    def __init__(self, app: ASGIApp, unlimited: tuple[str, str], limit_bytes: int = LIMIT_BYTES) -> None:
        self._app = app
        self._unlimited = unlimited
        self._limit_bytes = limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on with a body that is counted while it is read."""
        if scope["type"] != "http" or (scope["method"], scope["path"]) == self._unlimited:
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
