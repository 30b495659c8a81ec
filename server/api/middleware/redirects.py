"""Takes the host out of redirects, so that none follows the Host header of its request."""

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


class RelativeRedirects:
    """ASGI middleware. The framework redirects `/team/` to `/team` of the host that the client has named."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on, and make a redirect to its own host a path."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        named = f"{scope['scheme']}://{Headers(scope=scope).get('host', '')}/"

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                if (location := headers.get("location", "")).startswith(named):
                    headers["location"] = "/" + location.removeprefix(named).lstrip("/")
            await send(message)

        await self._app(scope, receive, sent)
