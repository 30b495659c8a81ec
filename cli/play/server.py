"""The page of `vitac play` and what it asks for, on this machine only. Called by `command`."""

import json
import secrets
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.training.demonstrations.collecting import DemonstrationKind
from vitac.training.demonstrations.hand_play import HandPlay

HOST = "127.0.0.1"
MAX_BODY_BYTES = 4096
PAGE_FILES = {"": ("page.html", "text/html"), "page.js": ("page.js", "text/javascript")}
_POLICY = "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'"


class PlayServer(HTTPServer):
    """Serves one person; the address has a secret, so that no page of somebody else can play.

    Args:
        played: the task.
        port: 0 for any that is free.
    """

    def __init__(self, played: HandPlay, port: int = 0) -> None:
        super().__init__((HOST, port), _Handler)
        self.played, self.secret = played, secrets.token_urlsafe(16)

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/{self.secret}/"


class _Handler(BaseHTTPRequestHandler):
    server: PlayServer

    def do_GET(self) -> None:
        named = self._asked()
        if named not in PAGE_FILES:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        file, kind = PAGE_FILES[named]
        self._send(Path(__file__).with_name(file).read_bytes(), kind)

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        if self._asked() is None or length > MAX_BODY_BYTES:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        try:
            content = answer(self.server.played, str(self._asked()), json.loads(self.rfile.read(length) or b"{}"))
            status = HTTPStatus.OK
        except (VitacError, ValueError, TypeError, KeyError) as error:
            content, status = {"error": str(error)}, HTTPStatus.UNPROCESSABLE_ENTITY
        self._send(json.dumps(content).encode(), "application/json", status)

    def log_message(self, *_: object) -> None:
        """Print no line for each request."""

    def _asked(self) -> str | None:
        """Return what is asked for behind the secret; None without it."""
        start = f"/{self.server.secret}/"
        return self.path.removeprefix(start) if self.path.startswith(start) else None

    def _send(self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)


def answer(played: HandPlay, asked: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer to a request of the page.

    Raises:
        NotPlayedByHand: an action does not fit.
        ValueError: something else is asked for.
    """
    if asked == "step":
        played.step(content["action"])
    elif asked == "next":
        played.begin()
    elif asked == "scene":
        return {**played.scene_mm(), "limits_mm": played.perspective.section.limits_mm}
    elif asked != "state":
        raise ValueError(f"There is no {asked!r:.40}; expected state, step, next or scene.")
    return describe_state(played)


def describe_state(played: HandPlay) -> dict[str, Any]:
    """Return what is shown of the running episode."""
    end = played.end_reason
    felt = [each for each in played.stored if each.kind is DemonstrationKind.HUMAN]
    return {
        "title": played.task.title,
        "actions": [{"name": each.name, "meaning": each.meaning} for each in played.task.actions],
        "control_rate_hz": played.control_rate_hz,
        "episode": played.number,
        "env_step": played.env_steps,
        "max_steps": played.task.max_steps,
        "motion": played.motion,
        "markers_px": played.markers_px,
        "end": None if end is None else EpisodeOutcome(end).sentence,
        "is_success": end == EpisodeOutcome.SUCCESS,
        "played": len(felt),
        "solved": sum(each.is_success for each in felt),
    }
