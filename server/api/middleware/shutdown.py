"""Answers requests that a stopping server gives up, so that a client knows that it may send them again."""

import asyncio

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...errors import ProblemCode, ServiceError
from ..problems import problem


class Shutdown:
    """ASGI middleware. The HTTP server cancels what is not answered in time, and would say 500 for it."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on; answer with a problem where it is cancelled before its answer has begun."""
        has_begun = False

        async def noting(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await self._app(scope, receive, noting)
        except asyncio.CancelledError:
            if scope["type"] != "http" or has_begun:
                raise
            refusal = ServiceError(
                ProblemCode.SERVICE_STOPPING,
                "The server is being stopped. It may have carried out this request or not; send it again in a moment.",
            )
            await problem(Request(scope), refusal, {"Connection": "close"})(scope, receive, send)
