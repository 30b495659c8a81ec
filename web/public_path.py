"""Puts the service below a path of its public address, as behind `location /arena/` of nginx. Called by `application`.

The service itself stands at the root: what comes has no prefix, and what goes gets it, in one place.
"""

import re

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_ADDRESS = re.compile(rb'(?<=[\s])((?:href|src|action|formaction|poster|data-[a-z-]+)=")/(?!/)')
"""An attribute of HTML that holds an address of this service."""
_WHOLE, _PIECES = "text/html", "text/event-stream"


class PublicPath:
    """Adds a path to all addresses that answers hold: links, forms, scripts, redirects and cookies.

    Args:
        app: the service at the root.
        path: such as "/arena", without a slash at the end.
    """

    def __init__(self, app: ASGIApp, path: str) -> None:
        self._app, self._path = app, path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, whether or not the proxy has taken the path off."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        at = scope["path"]
        if at == self._path or at.startswith(f"{self._path}/"):
            at = at[len(self._path) :] or "/"
        headers = [(name, value) for name, value in scope["headers"] if name != b"accept-encoding"]  # pages are changed
        await self._app({**scope, "path": at, "raw_path": at.encode(), "headers": headers}, receive, self._sender(send))

    def _sender(self, send: Send) -> Send:
        start: Message = {}
        body = b""

        async def add_path(message: Message) -> None:
            nonlocal start, body
            if message["type"] == "http.response.start":
                start = self._change_headers(message)
                if _kind(start) != _WHOLE:
                    await send(start)
            elif message["type"] != "http.response.body" or _kind(start) not in (_WHOLE, _PIECES):
                await send(message)
            elif _kind(start) == _PIECES:
                await send({**message, "body": self._change_addresses(message.get("body", b""))})
            else:
                body += message.get("body", b"")
                if not message.get("more_body", False):
                    body = self._change_addresses(body)
                    headers = MutableHeaders(scope=start)
                    if "content-length" in headers and body:
                        headers["content-length"] = str(len(body))
                    await send(start)
                    await send({"type": "http.response.body", "body": body})

        return add_path

    def _change_headers(self, start: Message) -> Message:
        changed = []
        for name, value in start["headers"]:
            if name == b"location" and value.startswith(b"/") and not value.startswith(b"//"):
                value = self._path.encode() + value
            elif name == b"set-cookie":
                value = re.sub(rb"(?i)(;\s*path=)/(?=;|$)", rb"\1" + self._path.encode(), value)
            changed.append((name, value))
        return {**start, "headers": changed}

    def _change_addresses(self, content: bytes) -> bytes:
        return _ADDRESS.sub(rb"\1" + self._path.encode() + b"/", content)


def _kind(start: Message) -> str:
    return MutableHeaders(scope=start).get("content-type", "").partition(";")[0]
