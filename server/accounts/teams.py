"""Teams: registration, look-up and listing."""

from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy import select, text
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.server.accounts.audit import record
from vitac.server.db.models import Team
from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode, ServiceError, not_found

from ..views.accounts import OrganizerTeamView, TeamView
from . import names
from .principals import Principal

NAME_LENGTH = 64
CONTACT_LENGTH = 254
REASON_LENGTH = 200
_REGISTRATION_LOCK = 0x7E414D5
"""Of two registrations at once the second sees the name of the first."""


def register(session: Session, by: Principal | None, *, name: str, contact: str | None = None) -> Team:
    """Make a team; `by` is None for somebody who registers their own.

    Raises:
        ServiceError: the name is taken (or looks like one that is) or cannot be shown.
    """
    shown = names.clean(name, what="A team's name", min_length=2, max_length=NAME_LENGTH)
    _refuse_look_alike(session, shown)
    added: Team | None = session.scalar(
        insert(Team)
        .values(name=shown, name_key=name_key(shown), contact=contact)
        .on_conflict_do_nothing(index_elements=[Team.name_key])
        .returning(Team)
    )
    if added is None:
        raise ServiceError(ProblemCode.TEAM_EXISTS, f"There is a team named {shown!r} already; choose another name.")
    actor = by or Principal(role=Role.TEAM, team_id=added.id, team_name=added.name)
    record(session, actor, "team.register", f"team:{added.id}", {"name": shown})
    return added


def find(session: Session, name_or_id: str) -> Team:
    """Return the team of that name or id.

    Raises:
        ServiceError: there is none.
    """
    team = session.scalar(select(Team).where(Team.name_key == name_key(name_or_id)))
    if team is None and (team_id := _as_uuid(name_or_id)) is not None:
        team = session.get(Team, team_id)
    if team is None:
        raise ServiceError(
            ProblemCode.UNKNOWN_TEAM, f"There is no team {name_or_id!r}; `vitac admin team list` shows all."
        )
    return team


def own(session: Session, by: Principal) -> Team:
    """Return the principal's team.

    Raises:
        ServiceError: an organizer belongs to none.
    """
    team = session.get(Team, by.team_id) if by.team_id is not None else None
    if team is None:
        raise not_found("team", "of this token")
    return team


def lock(session: Session, team: Team) -> None:
    """Let changes that count what a team has go on one after the other; rows that refer to the team are left alone."""
    session.execute(select(Team.id).where(Team.id == team.id).with_for_update(key_share=True))


def list_teams(session: Session) -> list[Team]:
    """Return all teams by name."""
    return list(session.scalars(select(Team).order_by(Team.name_key)))


def disqualify(session: Session, by: Principal, team: Team, reason: str) -> None:
    """Take a team off all boards and refuse its submissions from now on; its results stay.

    Raises:
        ServiceError: not an organizer, the reason cannot be shown, or the team is disqualified already.
    """
    by.require_organizer()
    shown = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    lock(session, team)
    session.refresh(team)
    if team.disqualified_for is not None:
        raise ServiceError(ProblemCode.TEAM_DISQUALIFIED, f"{team.name} is disqualified: {team.disqualified_for}.")
    team.disqualified_at, team.disqualified_for = datetime.now(UTC), shown
    record(session, by, "team.disqualify", f"team:{team.id}", {"reason": shown}, before={"reason": None})


def reinstate(session: Session, by: Principal, team: Team) -> None:
    """Let a disqualified team take part again, with all its results.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    lock(session, team)
    session.refresh(team)
    before = {"reason": team.disqualified_for}
    team.disqualified_at = team.disqualified_for = None
    record(session, by, "team.reinstate", f"team:{team.id}", {"reason": None}, before=before)


def team_view(team: Team) -> TeamView:
    """Return a team as everybody sees it."""
    return TeamView(id=team.id, name=team.name, created_at=team.created_at)


def organizer_team_view(team: Team) -> OrganizerTeamView:
    """Return a team as organizers see it."""
    return OrganizerTeamView(**dict(team_view(team)), contact=team.contact, disqualified_for=team.disqualified_for)


def name_key(name: str) -> str:
    """Return the name by which teams are told apart."""
    return names.key(name, max_length=NAME_LENGTH)


def _refuse_look_alike(session: Session, shown: str) -> None:
    """Refuse a name that readers would take for another team's."""
    session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _REGISTRATION_LOCK})
    others = session.scalars(select(Team.name).where(Team.name_key != name_key(shown)))
    taken = next((name for name in others if names.look_alike(shown, name)), None)
    if taken is not None:
        raise ServiceError(
            ProblemCode.TEAM_EXISTS, f"The name {shown!r} looks like that of team {taken!r}; choose another name."
        )


def _as_uuid(text: str) -> UUID | None:
    try:
        return UUID(text)
    except ValueError:
        return None
