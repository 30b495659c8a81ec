"""Refuses request heads that hold a NUL or say twice how long their body is, before anything reads them.

No name here holds a NUL, and PostgreSQL takes none in text. Where Content-Length and Transfer-Encoding are both there,
a proxy in front may see another end of the request than we do (RFC 9112, section 6.1).
"""

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from ...errors import ProblemCode, ServiceError
from ..problems import problem


class RequestHead:
    """ASGI middleware. Bodies are left to the models that read them."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a problem and close the connection, or hand the request on."""
        refusal = _refusal(scope) if scope["type"] == "http" else None
        if refusal is None:
            await self._app(scope, receive, send)
        else:
            await problem(Request(scope), refusal, {"Connection": "close"})(scope, receive, send)


def _refusal(scope: Scope) -> ServiceError | None:
    names = {name for name, _ in scope["headers"]}
    query: bytes = scope["query_string"]
    if {b"content-length", b"transfer-encoding"} <= names:
        return ServiceError(
            ProblemCode.LENGTH_INVALID, "The request has both Content-Length and Transfer-Encoding; send one of them."
        )
    if "\0" in scope["path"] or b"%00" in query or b"\0" in query:
        return ServiceError(ProblemCode.INVALID_REQUEST, "Path or query holds a NUL character; leave it out.")
    return None
