"""Refuses NUL in the path or query of any request: no name here holds one, and PostgreSQL takes none in text."""

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send
from vitac.server.errors import ProblemCode, ServiceError

from .problems import problem


class NulCharacters:
    """ASGI middleware. Bodies are left to the models that read them."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with 422 where there is one, else hand the request on."""
        if scope["type"] == "http" and _has_nul(scope):
            refusal = ServiceError(ProblemCode.INVALID_REQUEST, "Path or query holds a NUL character; leave it out.")
            await problem(Request(scope), refusal, {"Connection": "close"})(scope, receive, send)
            return
        await self._app(scope, receive, send)


def _has_nul(scope: Scope) -> bool:
    query: bytes = scope["query_string"]
    return "\0" in scope["path"] or b"%00" in query or b"\0" in query
