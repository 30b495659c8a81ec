"""The HTTP application: the server's API and the pages. Called by `vitac serve` and `vitac demo`."""

import re
from importlib.metadata import version
from urllib.parse import urlsplit

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from vitac.evaluator.tracks import list_tracks
from vitac.server.api.app import create_app
from vitac.server.api.middleware.requests import HttpMiddleware
from vitac.server.limiter import WindowLimiter
from vitac.server.services import Services
from vitac.server.settings import Settings
from vitac.server.tracks import sort_challenge_first

from .pages import routes
from .session import SessionSigner, load_key
from .sharing import checked_font
from .site import Site

_ADDRESS = re.compile(rb'(?<=[\s])((?:href|src|action|formaction|poster|data-[a-z-]+)=")/(?!/)')
"""An attribute of HTML that holds an address of this service."""
_WHOLE, _PIECES = "text/html", "text/event-stream"


class PublicPath(HttpMiddleware):
    """Adds a path to all addresses that answers hold: links, forms, scripts, redirects and cookies.

    Args:
        app: the service at the root.
        path: such as "/arena", without a slash at the end.
    """

    def __init__(self, app: ASGIApp, path: str) -> None:
        super().__init__(app)
        self._path = path

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, whether or not the proxy has taken the path off."""
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


KEY_FILE = "session.key"


def create(services: Services, *, sweeps: bool = True) -> FastAPI:
    """Return the application on open services; the caller closes them.

    Args:
        services: what it works with.
        sweeps: look for lost work; False where the process that started this one does.
    """
    settings = services.settings
    app = create_app(settings, services=services, uploads_at=routes.UPLOADS, sweeps=sweeps)
    site = Site(
        services=services,
        playbacks=WindowLimiter(
            settings.state_dir / "limits" / "playbacks", limit=settings.playbacks_per_address, window_s=3600.0
        ),
        signer=SessionSigner(key=signing_key(settings)),
        version=version("vitac-arena"),
        tracks=sort_challenge_first(list_tracks()),
        public_url=settings.public_url,
        preview_font=checked_font(settings.preview_font),
    )
    routes.install(app, site)
    if path := urlsplit(settings.public_url or "").path.rstrip("/"):
        app.add_middleware(PublicPath, path=path)
    return app


def signing_key(settings: Settings) -> bytes:
    """Return the key that signs page sessions: the configured one, else the state directory's."""
    if settings.session_key is not None:
        return settings.session_key.get_secret_value().encode()
    return load_key(settings.state_dir / KEY_FILE)
