"""The HTTP client of a service's API. Called by `submit`, `status` and `demo`."""

from __future__ import annotations

import hashlib
import os
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import httpx
from vitac.envs.errors import VitacError
from vitac.evaluator.submission_kinds import SubmissionKind

from .upload_kind import content_type

DEFAULT_SERVER = "http://127.0.0.1:8000"
CHUNK_BYTES = 1 << 18
TIMEOUT = httpx.Timeout(30.0, connect=10.0)
HINTS = {
    "missing_credentials": "Set VITAC_TOKEN to your team's API token, or give --token-file.",
    "invalid_credentials": "Check VITAC_TOKEN; ask an organizer for a new token if it was revoked or has expired.",
    "forbidden": "This token has no permission for that; use the right team's token, or an organizer's.",
    "not_found": "Check the id (`vitac status` lists yours) and the token.",
    "unknown_track": "Check the track's name in submission.yaml and with --track.",
    "log_rejected": "Make the log again with `vitac evaluate --log`, and upload one log at a time, unaltered; "
    "`vitac log import FILE` lists the problems of a 2025 text log.",
    "log_impossible": "Check it locally: `vitac log verify FILE`, or `vitac log import FILE` for a 2025 text log.",
    "log_team_mismatch": "Use the token of the team that the log names, or evaluate with --team.",
    "archive_rejected": "Run `vitac check` on the submission; it lists everything that would be refused.",
    "digest_mismatch": "The upload was corrupted in transit; send it again.",
    "upload_truncated": "The upload was cut off; send it again.",
    "upload_too_large": "Remove files that the policy does not need; a log holds one evaluation of one task.",
    "too_many_requests": "Wait a moment and retry.",
    "database_unavailable": "The database is starting or down; retry in a minute.",
    "storage_full": "Tell the organizers that the disk of the service is full.",
    "storage_unavailable": "The service cannot store files now; retry in a minute.",
}
Json = dict[str, Any]


class RequestRefused(VitacError):
    """The service refused a request; the message has status, code, detail, hint and request id."""

    def __init__(self, *, status: int, code: str, detail: str, request_id: str | None) -> None:
        self.status, self.code, self.detail, self.hint = status, code, detail, HINTS.get(code)
        lines = [f"refused with status {status} ({code}): {detail}"]
        if self.hint is not None:
            lines.append(f"hint: {self.hint}")
        if request_id is not None:
            lines.append(f"request id: {request_id}")
        super().__init__("\n  ".join(lines))


class ServiceUnreachable(VitacError):
    """No service answers at the address; the message names it and says what to check."""


@dataclass(frozen=True, kw_only=True)
class Client:
    """A service at an address, with a token.

    Attributes:
        server: address, as `http://127.0.0.1:8000`.
        token: API token; None for public data only.
        transport: HTTP transport; None: over the network.
    """

    server: str
    token: str | None = None
    transport: httpx.BaseTransport | None = None

    def me(self) -> Json:
        """Return the owner of the token."""
        return self._json("GET", "/api/v1/me")

    def submission(self, submission_id: str) -> Json:
        """Return one submission."""
        return self._json("GET", f"/api/v1/submissions/{submission_id}")

    def submissions(self, limit: int = 50) -> list[Json]:
        """Return the newest submissions that the token may see."""
        return list(self._json("GET", "/api/v1/submissions", params={"limit": limit})["items"])

    def leaderboard(self, track: str, *, task: str | None = None) -> Json:
        """Return the leaderboard of a track, or of one of its tasks."""
        return self._json("GET", f"/api/v1/leaderboards/{track}", params={"task": task} if task else {})

    def upload(
        self,
        archive: Path,
        *,
        track: str,
        kind: SubmissionKind = SubmissionKind.MODEL,
        team: str | None = None,
        again: bool = False,
        on_bytes: Callable[[int], None],
    ) -> Json:
        """Upload an archive or a log with its SHA-256, which the server checks.

        Args:
            archive: the file.
            track: name of the track.
            kind: what the file is.
            team: for an organizer's token: the team that submits.
            again: run all episodes, also those that were evaluated before.
            on_bytes: told the number of bytes after each piece.
        """
        with archive.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        headers = {
            "Content-Type": content_type(archive, kind),
            "Content-Length": str(archive.stat().st_size),
            "X-Content-SHA256": digest,
        }
        params = (
            {"track": track, "kind": kind.value}
            | ({"team": team} if team else {})
            | ({"again": "true"} if again else {})
        )
        return self._json(
            "POST", "/api/v1/submissions", params=params, headers=headers, content=_chunks(archive, on_bytes)
        )

    def _http(self) -> httpx.Client:
        return httpx.Client(
            base_url=self.server, timeout=TIMEOUT, transport=self.transport, trust_env=False, verify=_tls()
        )

    def _json(self, method: str, path: str, **arguments: Any) -> Json:
        headers = {"Accept": "application/json"} | arguments.pop("headers", {})
        if self.token is not None:
            headers["Authorization"] = f"Bearer {self.token}"
        try:
            with self._http() as http:
                answer = http.request(method, path, headers=headers, **arguments)
        except httpx.HTTPError as error:
            raise ServiceUnreachable(
                f"No service answers at {self.server} ({type(error).__name__}: {error}). Start one with `vitac serve`, "
                "or give the right address with --server or VITAC_SERVER."
            ) from error
        if answer.is_success:
            return dict(answer.json())
        raise _refusal(answer)


@cache
def _tls() -> ssl.SSLContext:
    """Read the certificates once; that takes longer than a request."""
    return httpx.create_ssl_context(trust_env=False)


def _chunks(archive: Path, on_bytes: Callable[[int], None]) -> Iterator[bytes]:
    with archive.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            yield chunk
            on_bytes(len(chunk))


def _refusal(answer: httpx.Response) -> RequestRefused:
    request_id = answer.headers.get("x-request-id")
    try:
        problem = dict(answer.json())
    except ValueError:
        problem = {}
    return RequestRefused(
        status=answer.status_code,
        code=str(problem.get("code", "no_code")),
        detail=str(problem.get("detail", f"{answer.reason_phrase}; this may not be a ViTac Arena service")),
        request_id=request_id,
    )


def client_from(server: str | None, token_file: Path | None) -> Client:
    """Return a client configured by options and environment (VITAC_SERVER, VITAC_TOKEN).

    Raises:
        VitacError: the address is invalid, or the token's file cannot be read.
    """
    address = server or os.environ.get("VITAC_SERVER") or DEFAULT_SERVER
    if not address.startswith(("http://", "https://")):
        raise VitacError(f"Expected a service address like {DEFAULT_SERVER}, got {address!r}.")
    return Client(server=address.rstrip("/"), token=_token(token_file))


def _token(token_file: Path | None) -> str | None:
    if token_file is None:
        return os.environ.get("VITAC_TOKEN") or None
    try:
        return token_file.read_text().strip()
    except OSError as error:
        raise VitacError(
            f"The token's file {token_file} cannot be read: {error.strerror}. Check --token-file."
        ) from error
