"""A team registers itself, or an organizer registers it: by the rule of the settings. Called by API and pages."""

import hmac
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy.orm import Session

from ..database.models import Team
from ..errors import ProblemCode, ServiceError
from ..principals import CONSOLE, Principal
from ..settings import Registration, Settings
from . import members, teams, tokens
from .tokens import IssuedToken


@dataclass(frozen=True, kw_only=True)
class RegisteringTeam:
    """What somebody says who wants to take part.

    Attributes:
        name: shown on the leaderboard.
        contact: where organizers reach the team.
        invite: the invite code.
    """

    name: str
    contact: str | None = None
    invite: str | None = None


def register(
    session: Session, settings: Settings, by: Principal | None, new: RegisteringTeam
) -> tuple[Team, IssuedToken]:
    """Make a team with its captain's token.

    Args:
        session: of the transaction.
        settings: who may register.
        by: an organizer; None for somebody who registers their own team.
        new: the team.

    Raises:
        ServiceError: registration is closed or needs another invite code, or the name cannot be used.
    """
    by_organizer = by is not None and by.organizes_service
    if not by_organizer:
        _require_open(session, settings, new.invite)
    waits = not by_organizer and settings.registration is Registration.APPROVAL
    team = teams.register(session, by, name=new.name, contact=new.contact, waits=waits)
    lifetime = timedelta(days=settings.token_lifetime_days)
    return team, tokens.issue_to_member(session, CONSOLE, members.find_captain(session, team), lifetime)


def _require_open(session: Session, settings: Settings, invite: str | None) -> None:
    teams.require_unlocked(session, None)
    if settings.registration is Registration.CLOSED:
        raise ServiceError(ProblemCode.REGISTRATION_CLOSED, "Only organizers register teams here; ask them.")
    if settings.registration is Registration.INVITE and not _is_invited(settings, invite):
        raise ServiceError(
            ProblemCode.INVITE_REQUIRED,
            f"Registration needs the invite code, got {'another one' if invite else 'none'}; ask the organizers.",
        )


def _is_invited(settings: Settings, invite: str | None) -> bool:
    expected = settings.invite_code.get_secret_value() if settings.invite_code is not None else ""
    return bool(expected) and hmac.compare_digest((invite or "").encode(), expected.encode())
