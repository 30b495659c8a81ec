"""The tokens that `vitac login` and `vitac register` keep, one for each service, in a file that only the user may read.

Called by the commands of this folder, and by `http` for all that talk to a service.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from vitac.errors import VitacError

FILE = "vitac/credentials.json"


class CredentialsUnusable(VitacError):
    """The file with the stored tokens cannot be read or written; the message names it."""


def path() -> Path:
    """Return the file, in the user's configuration."""
    folder = os.environ.get("XDG_CONFIG_HOME")
    return (Path(folder) if folder else Path.home() / ".config") / FILE


def find_stored_token(server: str) -> str | None:
    """Return the token that is stored for a service, or None."""
    token = _load()["tokens"].get(server)
    return token if isinstance(token, str) else None


def last_server() -> str | None:
    """Return the service of the last login, or None."""
    server = _load()["server"]
    return server if isinstance(server, str) else None


def keep(server: str, token: str) -> None:
    """Store a token, and make its service the default."""
    stored = _load()
    stored["tokens"][server] = token
    _store({"server": server, "tokens": stored["tokens"]})


def forget(server: str) -> bool:
    """Remove the token of a service; return whether there was one."""
    stored = _load()
    if stored["tokens"].pop(server, None) is None:
        return False
    if stored["server"] == server:
        stored["server"] = None
    _store(stored)
    return True


def _load() -> dict[str, Any]:
    try:
        content = json.loads(path().read_text())
        return {"server": content["server"], "tokens": dict(content["tokens"])}
    except FileNotFoundError:
        return {"server": None, "tokens": {}}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CredentialsUnusable(
            f"The stored tokens in {path()} cannot be read ({error}); remove the file."
        ) from error


def _store(content: dict[str, Any]) -> None:
    """Replace the file as a whole, so that a command that is killed leaves the old or the new one."""
    target = path()
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
