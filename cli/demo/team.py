"""The demo's own team and its token, stored between runs in the state directory. Called by `demo`."""

import os
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy.orm import Session
from vitac.server.database.engine import Database

if TYPE_CHECKING:
    from vitac.server.database.models import Team

TEAM = "demo"
TOKEN_FILE = "demo-token"  # noqa: S105 - a file's name
TOKEN_LIFETIME = timedelta(days=365)


def team_token(database: Database, state_dir: Path) -> str:
    """Return a valid token of the team `demo`; create team and token if missing or no longer valid."""
    path = state_dir / TOKEN_FILE
    with database.transaction() as session:
        stored = path.read_text().strip() if path.exists() else ""
        if stored and _is_valid(session, stored):
            return stored
        secret = _issue(session)
    _write_private(path, secret)
    return secret


def _is_valid(session: Session, secret: str) -> bool:
    from vitac.server.accounts import tokens
    from vitac.server.errors import ServiceError

    try:
        return tokens.authenticate(session, secret).team_name == TEAM
    except ServiceError:
        return False


def _issue(session: Session) -> str:
    from vitac.server.accounts import tokens
    from vitac.server.database.states import Role
    from vitac.server.principals import CONSOLE

    issued = tokens.issue(
        session, CONSOLE, role=Role.TEAM, label="vitac demo", team=_find_or_register(session), lifetime=TOKEN_LIFETIME
    )
    return issued.secret


def _find_or_register(session: Session) -> "Team":
    from vitac.server.accounts import teams
    from vitac.server.errors import ProblemCode, ServiceError
    from vitac.server.principals import CONSOLE

    try:
        return teams.find(session, TEAM)
    except ServiceError as error:
        if error.code is not ProblemCode.UNKNOWN_TEAM:
            raise
    return teams.register(session, CONSOLE, name=TEAM)


def _write_private(path: Path, secret: str) -> None:
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(secret + "\n")
