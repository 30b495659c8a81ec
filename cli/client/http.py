"""How commands reach a service: requests with their limits, and the tokens that `vitac login` stores."""

from __future__ import annotations

import hashlib
import json
import os
import re
import ssl
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
from vitac.errors import VitacError
from vitac.evaluator.submission_kinds import SubmissionKind

from .answers import Answer, ServiceUnreachable, decode, decode_object, refusal
from .pieces import PieceSender

DEFAULT_SERVER = "http://127.0.0.1:8000"
TIMEOUT_S = 30.0
CONNECT_TIMEOUT_S = 10.0
Json = dict[str, Any]
_TOKEN = re.compile(r"[!-~]+")
"""What can be sent as a token; whether it is one, the service says."""


class TokenUnusable(VitacError):
    """The token is empty or has blanks or letters that none has; the message says where it is from."""


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

    def __post_init__(self) -> None:
        """Refuse what cannot be sent as a token: to `httpx` it would look like a broken connection."""
        if self.token is not None and not _TOKEN.fullmatch(self.token):
            got = "more than one word or other letters" if self.token else "nothing"
            raise TokenUnusable(
                f"Expected one API token of `vitac_` and 43 letters, digits, - or _ for {self.server}, got {got}. Copy "
                "it again, for `vitac login` or into the file or VITAC_TOKEN that you use."
            )

    def me(self) -> Json:
        """Return the owner of the token."""
        return self._json("GET", "/api/v1/me")

    def call(self, method: str, path: str, body: Json | None = None) -> Json:
        """Send JSON and return what is answered; nothing for an answer without content."""
        content = None if body is None else json.dumps(body).encode()
        headers = {} if body is None else {"Content-Type": "application/json"}
        answer = self.send(method, path, headers=headers, content=content)
        return decode_object(answer) if answer.content else {}

    def register(self, name: str, *, contact: str | None, invite: str | None) -> Json:
        """Register a team and return it with its first token."""
        new = {"name": name, "contact": contact, "invite": invite}
        return self.call("POST", "/api/v1/teams", {key: value for key, value in new.items() if value is not None})

    def revoke(self, token_id: str) -> None:
        """Revoke a token."""
        self.send("DELETE", f"/api/v1/tokens/{token_id}")

    def submission(self, submission_id: str) -> Json:
        """Return one submission."""
        return self._json("GET", f"/api/v1/submissions/{submission_id}")

    def set_public(self, submission_id: str, *, public: bool) -> Json:
        """Let everybody see the result of a submission, or its team only; return it."""
        content = json.dumps({"public": public}).encode()
        headers = {"Content-Type": "application/json"}
        return self._json("PUT", f"/api/v1/submissions/{submission_id}/public", content=content, headers=headers)

    def episodes(self, submission_id: str) -> list[Answer]:
        """Return how each finished episode of a submission ended."""
        return list(decode(self.send("GET", f"/api/v1/submissions/{submission_id}/episodes")))

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
        track: str | None,
        competition: str | None = None,
        kind: SubmissionKind = SubmissionKind.MODEL,
        team: str | None = None,
        again: bool = False,
        file_name: str | None = None,
        on_position: Callable[[int], None],
        on_known: Callable[[], object] = lambda: None,
    ) -> Json:
        """Upload an archive or a log with its SHA-256, which the server checks; cuts on the way are mended.

        Args:
            archive: the file.
            track: name of the track; None: the one that the file is of.
            competition: name of the competition; None: the one that takes submissions to the track.
            kind: what the file is.
            team: for an organizer's token: the team that submits.
            again: run all episodes, also those that were evaluated before.
            file_name: as the user names it; None if the user did not name it.
            on_position: called with the number of bytes sent; after a lost connection it may be lower than before.
            on_known: called where the team had submitted the content before, so that nothing was started.
        """
        with archive.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        metadata = (
            {"kind": kind.value, "sha256": digest}
            | ({"track": track} if track else {})
            | ({"competition": competition} if competition else {})
            | ({"team": team} if team else {})
            | ({"again": "true"} if again else {})
            | ({"filename": file_name} if file_name else {})
        )
        sender = PieceSender(
            send=self.send, file=archive, metadata=metadata, on_position=on_position, on_known=on_known
        )
        return sender.run()

    def send(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] = MappingProxyType({}),
        params: Mapping[str, Any] = MappingProxyType({}),
        content: Iterable[bytes] | bytes | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> httpx.Response:
        """Send a request and return its answer.

        Args:
            method: of HTTP.
            path: on the server.
            headers: besides the token.
            params: of the query.
            content: of the body.
            timeout_s: how long the server may take to answer.

        Raises:
            RequestRefused: the service refuses it.
            ServiceUnreachable: nothing answers, or the connection was cut.
        """
        token = {"Authorization": f"Bearer {self.token}"} if self.token is not None else {}
        all_headers = {"Accept": "application/json", **headers, **token}
        try:
            with self._http(timeout_s) as http:
                answer = http.request(method, path, headers=all_headers, params=params, content=content)
        except httpx.HTTPError as error:
            raise ServiceUnreachable(
                f"No service answers at {self.server} ({type(error).__name__}: {error}). Start one with `vitac serve`, "
                "or give the right address with --server or VITAC_SERVER."
            ) from error
        if answer.is_success:
            return answer
        raise refusal(answer)

    def _http(self, timeout_s: float) -> httpx.Client:
        timeout = httpx.Timeout(TIMEOUT_S, connect=CONNECT_TIMEOUT_S, read=timeout_s)
        return httpx.Client(
            base_url=self.server, timeout=timeout, transport=self.transport, trust_env=False, verify=_tls()
        )

    def _json(self, method: str, path: str, **arguments: Any) -> Json:
        return decode_object(self.send(method, path, **arguments))


@cache
def _tls() -> ssl.SSLContext:
    """Read the certificates once; that takes longer than a request."""
    return httpx.create_ssl_context(trust_env=False)


def make_client(server: str | None, token_file: Path | None, *, with_token: bool = True) -> Client:
    """Return a client configured by options, environment (VITAC_SERVER, VITAC_TOKEN) and what `vitac login` keeps.

    Args:
        server: address; None: that of the environment, else that of the last login.
        token_file: file with the token; None: that of the environment, else the kept one of that service. The service
            of the last login gets its own token only, as nothing says that the environment's is meant for it.
        with_token: whether a token is used at all.

    Raises:
        VitacError: the address is invalid, or the token's file cannot be read.
    """
    named = server or os.environ.get("VITAC_SERVER")
    last = None if named else last_server()
    address = named or last or DEFAULT_SERVER
    if not address.startswith(("http://", "https://")):
        raise VitacError(f"Expected a service address like {DEFAULT_SERVER}, got {address!r}.")
    address = address.rstrip("/")
    if not with_token:
        return Client(server=address)
    if token_file is not None:
        return Client(server=address, token=read_token(token_file))
    from_environment = None if last else os.environ.get("VITAC_TOKEN")
    return Client(server=address, token=from_environment or find_stored_token(address))


def read_token(token_file: Path) -> str:
    """Return the token in a file.

    Raises:
        VitacError: the file cannot be read.
    """
    try:
        return token_file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError as error:
        raise VitacError(
            f"The token's file {token_file} cannot be read: {error.strerror}. Check --token-file."
        ) from error


CREDENTIALS_FILE = "vitac/credentials.json"


class CredentialsUnusable(VitacError):
    """The file with the stored tokens cannot be read or written; the message names it."""


def credentials_file() -> Path:
    """Return the file, in the user's configuration."""
    folder = os.environ.get("XDG_CONFIG_HOME")
    return (Path(folder) if folder else Path.home() / ".config") / CREDENTIALS_FILE


def find_stored_token(server: str) -> str | None:
    """Return the token that is stored for a service, or None."""
    token = _read_credentials()["tokens"].get(server)
    return token if isinstance(token, str) else None


def last_server() -> str | None:
    """Return the service of the last login, or None."""
    server = _read_credentials()["server"]
    return server if isinstance(server, str) else None


def store_token(server: str, token: str) -> None:
    """Store a token, and make its service the default."""
    stored = _read_credentials()
    stored["tokens"][server] = token
    _write_credentials({"server": server, "tokens": stored["tokens"]})


def forget_token(server: str) -> bool:
    """Remove the token of a service; return whether there was one."""
    stored = _read_credentials()
    if stored["tokens"].pop(server, None) is None:
        return False
    if stored["server"] == server:
        stored["server"] = None
    _write_credentials(stored)
    return True


def _read_credentials() -> dict[str, Any]:
    try:
        content = json.loads(credentials_file().read_text())
        return {"server": content["server"], "tokens": dict(content["tokens"])}
    except FileNotFoundError:
        return {"server": None, "tokens": {}}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CredentialsUnusable(
            f"The stored tokens in {credentials_file()} cannot be read ({error}); remove the file."
        ) from error


def _write_credentials(content: dict[str, Any]) -> None:
    """Replace the file as a whole, so that a command that is killed leaves the old or the new one."""
    target = credentials_file()
    try:
        target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor, draft = tempfile.mkstemp(dir=target.parent, prefix=f"{target.name}.")  # mode 0600
        try:
            with os.fdopen(descriptor, "w") as file:
                json.dump(content, file, indent=1)
            Path(draft).replace(target)
        except BaseException:
            Path(draft).unlink()
            raise
    except OSError as error:
        raise CredentialsUnusable(f"The token cannot be stored in {target}: {error.strerror}.") from error
