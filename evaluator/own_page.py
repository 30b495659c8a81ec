"""A page for the people at this machine; `vitac play` and the console of a station have one.

It is bound to this machine alone and stands behind a secret in its address, so that no page of another site can ask
anything.
"""

import json
import secrets
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, Final, NamedTuple

from vitac.errors import VitacError

HOST: Final = "127.0.0.1"
MAX_BODY_BYTES: Final = 4096
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; connect-src 'self'; img-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class PageFile(NamedTuple):
    """A file of the page, and its type."""

    path: Path
    content_type: str


class OwnPageServer(HTTPServer):
    """Serves a page and answers it.

    Args:
        files: by their names in the address; the page itself has none.
        port: 0 for any that is free.
    """

    def __init__(self, files: Mapping[str, PageFile], port: int = 0) -> None:
        super().__init__((HOST, port), _Handler)
        self.files, self.secret = files, secrets.token_urlsafe(16)

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/{self.secret}/"

    def answer(self, asked: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a request of the page; a VitacError, ValueError, TypeError or KeyError refuses it."""
        raise NotImplementedError

    def read_picture(self, named: str) -> bytes | None:
        """Return a picture as JPEG; None where there is none of that name."""
        del named
        return None


class _Handler(BaseHTTPRequestHandler):
    server: OwnPageServer

    def do_GET(self) -> None:
        named = (self._asked() or "").partition("?")[0]
        if self._asked() is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif named in self.server.files:
            file, kind = self.server.files[named]
            self._send(file.read_bytes(), f"{kind}; charset=utf-8")
        elif (picture := self.server.read_picture(named)) is not None:
            self._send(picture, "image/jpeg")
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        asked = self._asked()
        if asked is None or length > MAX_BODY_BYTES:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        try:
            content = self.server.answer(asked, json.loads(self.rfile.read(length) or b"{}"))
            status = HTTPStatus.OK
        except (VitacError, ValueError, TypeError, KeyError) as error:
            content, status = {"error": str(error)}, HTTPStatus.UNPROCESSABLE_ENTITY
        self._send(json.dumps(content).encode(), "application/json; charset=utf-8", status)

    def log_message(self, *_: object) -> None:
        """Print no line for each request."""

    def _asked(self) -> str | None:
        """Return what is asked for behind the secret; None without it."""
        start = f"/{self.server.secret}/"
        return self.path.removeprefix(start) if self.path.startswith(start) else None

    def _send(self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)
