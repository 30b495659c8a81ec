"""Teams: registration, look-up and listing."""

from datetime import datetime
from uuid import UUID

from sqlalchemy import func, select, text
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import ApiToken, Member, Team
from ..database.states import MemberRole, Role
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import CONSOLE, Principal
from ..views.teams import OrganizerTeamView, TeamView
from .shown_names import ShownNames

NAME_LENGTH = 64
CONTACT_LENGTH = 254
REASON_LENGTH = 200
_REGISTRATION_LOCK = 0x7E414D5
"""Advisory lock: of two simultaneous registrations the second sees the name of the first."""


def register(
    session: Session, by: Principal | None, *, name: str, contact: str | None = None, waits: bool = False
) -> Team:
    """Make a team with a captain.

    Args:
        session: of the transaction.
        by: None for somebody who registers their own.
        name: shown on boards.
        contact: for the organizers.
        waits: whether an organizer has to accept it before it submits.

    Raises:
        ServiceError: the name is taken (or looks like one that is) or cannot be shown.
    """
    shown = _checked_name(session, by, name)
    approved_at = None if waits else read_clock(session)
    added = Team(name=shown, name_key=name_key(shown), contact=contact, approved_at=approved_at)
    session.add(added)
    session.flush()
    actor = by or Principal(role=Role.TEAM, team_id=added.id, team_name=added.name)
    record(session, actor, "team.register", f"team:{added.id}", {"name": shown})
    session.add(Member(team=added, role=MemberRole.CAPTAIN, name="Captain", name_key="captain"))
    session.flush()
    return added


def rename(session: Session, by: Principal, team: Team, name: str) -> None:
    """Give a team another name.

    Raises:
        ServiceError: not an organizer, or the name is taken, looks like one that is, or cannot be shown.
    """
    by.require_organizer()
    lock(session, team)
    shown = _checked_name(session, by, name, but=team)
    before = {"name": team.name}
    team.name, team.name_key, team.named_at = shown, name_key(shown), read_clock(session)
    record(session, by, "team.rename", f"team:{team.id}", {"name": shown}, before=before)


def accept(session: Session, by: Principal, team: Team) -> None:
    """Let a team submit that has waited, or that was refused; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    lock(session, team)
    session.refresh(team)
    if team.approved_at is None:
        before = {"accepted": False, "reason": team.refused_for}
        team.approved_at, team.refused_for = read_clock(session), None
        record(session, by, "team.accept", f"team:{team.id}", {"accepted": True}, before=before)


def refuse(session: Session, by: Principal, team: Team, reason: str) -> None:
    """Refuse a team that waits to be accepted.

    Raises:
        ServiceError: not an organizer, the reason cannot be shown, or the team was accepted already.
    """
    by.require_organizer()
    shown = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    lock(session, team)
    session.refresh(team)
    if team.approved_at is not None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{team.name} was accepted already; `vitac admin team disqualify` ends it."
        )
    before = {"accepted": False, "reason": team.refused_for}
    team.refused_for = shown
    record(session, by, "team.refuse", f"team:{team.id}", {"accepted": False, "reason": shown}, before=before)


def waiting(session: Session) -> list[Team]:
    """Return the teams that wait to be accepted, the one that has waited longest first."""
    is_waiting = Team.approved_at.is_(None), Team.refused_for.is_(None)
    return list(session.scalars(select(Team).where(*is_waiting).order_by(Team.created_at, Team.id)))


def require_taking_part(team: Team) -> None:
    """Refuse the submissions of a team that may not make any.

    Raises:
        ServiceError: it is removed, disqualified, waits to be accepted, or was refused.
    """
    if team.erased_at is not None:
        raise _removed()
    if team.disqualified_at is not None:
        raise ServiceError(
            ProblemCode.TEAM_DISQUALIFIED, f"{team.name} is disqualified: {team.disqualified_for}. Ask the organizers."
        )
    if team.approved_at is None:
        state = f"was refused: {team.refused_for}" if team.refused_for else "waits until an organizer accepts it"
        raise ServiceError(ProblemCode.TEAM_NOT_ACCEPTED, f"{team.name} {state}, so it cannot submit.")


def require_unlocked(session: Session, by: Principal | None) -> None:
    """Refuse changes of teams after the competition's lock date to everybody but organizers.

    Raises:
        ServiceError: teams are locked.
    """
    if by is not None and by.organizes_service:
        return
    if at := find_lock_date(session):
        raise ServiceError(
            ProblemCode.REGISTRATION_CLOSED,
            f"Teams have been locked since {at:%F %T} UTC; only organizers change them.",
        )


def find_lock_date(session: Session) -> datetime | None:
    """Return the last lock date of the competitions that are not final, if all are over; with none, of all."""
    competitions = Competition.read_all(session)
    running = [one for one in competitions if one.row.finalized_at is None] or competitions
    dates = [one.definition.teams_locked for one in running]
    over = [at for at in dates if at is not None and at <= read_clock(session)]
    return max(over) if len(over) == len(dates) else None


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


def find_as_organizer(session: Session, by: Principal, name_or_id: str) -> Team:
    """Return the team of that name or id; others than organizers do not learn whether there is one.

    Raises:
        ServiceError: not an organizer of the service, or there is none.
    """
    by.require_organizer()
    return find(session, name_or_id)


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
    """Serialize changes that count what a team has; rows that refer to the team are left alone.

    Raises:
        ServiceError: the team was merged with another one or removed meanwhile.
    """
    row = session.execute(
        select(Team.erased_at).where(Team.id == team.id).with_for_update(key_share=True)
    ).one_or_none()
    if row is None:
        raise ServiceError(ProblemCode.UNKNOWN_TEAM, "This team was merged with another one. Try again.")
    if row.erased_at is not None:
        raise _removed()


def find_last_naming(session: Session) -> datetime | None:
    """Return when a team was last shown under another name; None: there is no team."""
    return session.scalar(select(func.max(Team.named_at)))


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
    team.disqualified_at, team.disqualified_for = read_clock(session), shown
    record(session, by, "team.disqualify", f"team:{team.id}", {"reason": shown}, before={"reason": None})


def reinstate(session: Session, by: Principal, team: Team) -> None:
    """Let a disqualified team take part again, with all its results; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    lock(session, team)
    session.refresh(team)
    if team.disqualified_at is not None:
        before = {"reason": team.disqualified_for}
        team.disqualified_at = team.disqualified_for = None
        record(session, by, "team.reinstate", f"team:{team.id}", {"reason": None}, before=before)


def team_view(team: Team, names_shown: ShownNames) -> TeamView:
    """Return a team as somebody sees it."""
    return TeamView(
        id=names_shown.show_id(team),
        name=names_shown.show_name(team),
        shown_as=names_shown.name_for_others(team),
        created_at=None if names_shown.hides(team) else team.created_at,
    )


def organizer_team_view(session: Session, team: Team) -> OrganizerTeamView:
    """Return a team as organizers see it."""
    return OrganizerTeamView.from_row(team, **dict(team_view(team, ShownNames.read(session, CONSOLE))))


def name_key(name: str) -> str:
    """Return the key that is unique among teams."""
    return names.key(name, max_length=NAME_LENGTH)


def _removed() -> ServiceError:
    return ServiceError(ProblemCode.UNKNOWN_TEAM, "This team was removed; nothing about it can be changed.")


def _checked_name(session: Session, by: Principal | None, name: str, *, but: Team | None = None) -> str:
    """Return a name as it is shown; refuse one that readers would take for that of others.

    While names are hidden the answer is the same for all reasons: it would say which teams there are.

    Raises:
        ServiceError: the name is taken, reserved, looks like one that is, or cannot be shown.
    """
    shown = names.clean(name, what="A team's name", min_length=1, max_length=NAME_LENGTH)
    session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _REGISTRATION_LOCK})
    problem = _find_name_problem(session, by, shown, but)
    if problem is not None and not (by is not None and by.organizes_service) and ShownNames.read(session).hidden:
        problem = f"The name {shown!r} is reserved, taken, or looks like one that is"
    if problem is not None:
        raise ServiceError(ProblemCode.TEAM_EXISTS, f"{problem}; choose another name.")
    return shown


def _find_name_problem(session: Session, by: Principal | None, shown: str, but: Team | None) -> str | None:
    """Return why nobody else may have a name; an organizer's own team may have a reserved one."""
    is_own = by is not None and by.organizes_service
    if not is_own and names.is_reserved(shown):
        return f"The name {shown!r} is reserved for those who run this service"
    query = select(Team.name, Team.pseudonym)
    others = session.execute(query if but is None else query.where(Team.id != but.id)).all()
    if any(name_key(row.name) == name_key(shown) for row in others):
        return f"There is a team named {shown!r} already"
    alike = next((row.name for row in others if names.look_alike(shown, row.name)), None)
    if alike is not None:
        return f"The name {shown!r} looks like that of team {alike!r}"
    judges = session.scalars(select(ApiToken.label).where(ApiToken.role == Role.JUDGE))
    if not is_own and any(names.look_alike(shown, judge) for judge in judges):
        return f"The name {shown!r} is that of somebody who runs this service"
    if any(names.look_alike(shown, row.pseudonym) for row in others):
        return f"The name {shown!r} looks like one under which another team is shown"
    if not is_own and names.mixes_scripts(shown):
        return f"The name {shown!r} mixes Latin and Cyrillic letters in a word"
    return None


def _as_uuid(text: str) -> UUID | None:
    try:
        return UUID(text)
    except ValueError:
        return None
