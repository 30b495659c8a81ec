"""Counts requests and measures the time to their answers, by route."""

import asyncio
import secrets
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from http import HTTPMethod

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...errors import ProblemCode, ServiceError
from ...services import Services
from ..problems import problem

UNKNOWN = "unknown"
"""Label of what no route answers: names that clients make up may not become labels."""
_METHODS = frozenset(HTTPMethod)


class HttpMiddleware(ABC):
    """ASGI middleware that leaves alone what is no HTTP request."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand all else on."""
        await (self.handle if scope["type"] == "http" else self._app)(scope, receive, send)

    @abstractmethod
    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""


def when_answered(send: Send, change: Callable[[Message], object]) -> Send:
    """Return what sends an answer, and changes its status and headers before."""

    async def changed(message: Message) -> None:
        if message["type"] == "http.response.start":
            change(message)
        await send(message)

    return changed


class RequestTimes(HttpMiddleware):
    """ASGI middleware. The services are those of the application at the time of the request."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on and measure the time until its answer begins."""
        begun = time.perf_counter()

        def measure(message: Message) -> None:
            services: Services = scope["app"].state.services
            labels = (find_method(scope), find_route(scope), f"{message['status'] // 100}xx")
            services.instruments.requests_s.labels(*labels).observe(time.perf_counter() - begun)

        await self._app(scope, receive, when_answered(send, measure))


def find_method(scope: Scope) -> str:
    """Return the method, or `unknown` for one that HTTP does not have."""
    return scope["method"] if scope["method"] in _METHODS else UNKNOWN


def find_route(scope: Scope) -> str:
    """Return the path of the route that answered, with names for its parameters: `/submissions/{submission_id}`."""
    if "endpoint" not in scope:
        return UNKNOWN
    root: str = scope.get("root_path", "")
    if root:  # of a mount, such as that of the static files
        return f"{root}/*"
    names = {str(value): f"{{{name}}}" for name, value in scope.get("path_params", {}).items()}
    return "/".join(names.get(part, part) for part in scope["path"].split("/"))


LIMIT_BYTES = 64 * 1024
TOO_LARGE = 413
TOO_SLOW = 408
BODY_TIMEOUT_S = 30.0
"""A body that has not arrived after this time is given up, however steadily it trickles."""


class BodyLimit(HttpMiddleware):
    """ASGI middleware. A body that is too large is never held in memory: it ends with 413, a slow one with 408.

    `unlimited` names methods and paths, or paths up to their last slash, that count for themselves.
    """

    def __init__(self, app: ASGIApp, unlimited: Collection[tuple[str, str]], limit_bytes: int = LIMIT_BYTES) -> None:
        super().__init__(app)
        self._unlimited = frozenset(unlimited)
        self._limit_bytes = limit_bytes

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on with a body that is counted while it is read."""
        if matches_route(self._unlimited, scope):
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


class RequestHead(HttpMiddleware):
    """ASGI middleware. Bodies are left to the models that read them."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a problem and close the connection, or hand the request on."""
        refusal = _refusal(scope)
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


class Shutdown(HttpMiddleware):
    """ASGI middleware. The HTTP server cancels what is not answered in time, and would say 500 for it."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on; answer with a problem where it is cancelled before its answer has begun."""
        has_begun = False

        async def noting(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await self._app(scope, receive, noting)
        except asyncio.CancelledError:
            if has_begun:
                raise
            refusal = ServiceError(
                ProblemCode.SERVICE_STOPPING,
                "The server is being stopped. It may have carried out this request or not; send it again in a moment.",
            )
            await problem(Request(scope), refusal, {"Connection": "close"})(scope, receive, send)


HEADER = b"x-request-id"


class RequestIds(HttpMiddleware):
    """ASGI middleware. The id is in the scope's state as `request_id`."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on with its id."""
        request_id = secrets.token_hex(8)
        scope.setdefault("state", {})["request_id"] = request_id

        def name(message: Message) -> None:
            message.setdefault("headers", []).append((HEADER, request_id.encode()))

        with structlog.contextvars.bound_contextvars(request=request_id):
            await self._app(scope, receive, when_answered(send, name))


class RelativeRedirects(HttpMiddleware):
    """ASGI middleware. The framework redirects `/team/` to `/team` of the host that the client has named."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on, and make a redirect to its own host a path."""
        named = f"{scope['scheme']}://{Headers(scope=scope).get('host', '')}/"

        def shorten(message: Message) -> None:
            headers = MutableHeaders(scope=message)
            if (location := headers.get("location", "")).startswith(named):
                headers["location"] = "/" + location.removeprefix(named).lstrip("/")

        await self._app(scope, receive, when_answered(send, shorten))
