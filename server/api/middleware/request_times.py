"""Counts requests and measures the time to their answers, by route."""

import time
from http import HTTPMethod

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...services import Services

UNKNOWN = "unknown"
"""Label of what no route answers: names that clients make up may not become labels."""
_METHODS = frozenset(HTTPMethod)


class RequestTimes:
    """ASGI middleware. The services are those of the application at the time of the request."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on and measure the time until its answer begins."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = time.perf_counter()

        async def measured(message: Message) -> None:
            if message["type"] == "http.response.start":
                services: Services = scope["app"].state.services
                labels = (find_method(scope), find_route(scope), f"{message['status'] // 100}xx")
                services.instruments.requests_s.labels(*labels).observe(time.perf_counter() - begun)
            await send(message)

        await self._app(scope, receive, measured)


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
