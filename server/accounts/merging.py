"""Two teams become one, with all submissions, members and tokens of both. Called by the organizers' commands."""

from datetime import datetime, timedelta

from sqlalchemy import delete, exists, func, select, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, aliased

from ..audit import record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import (
    Announcement,
    ApiToken,
    Appeal,
    BoardResult,
    Brief,
    EnteredResult,
    Invitation,
    JudgingConflict,
    Member,
    Notice,
    PartialUpload,
    Qualification,
    Question,
    Submission,
    Team,
    Webhook,
)
from ..database.states import MemberRole, NoticeChannel
from ..errors import ProblemCode, ServiceError
from ..principals import CONSOLE, Principal
from ..settings import Settings
from . import teams


def merge(session: Session, by: Principal, team: Team, into: Team) -> None:
    """Give another team everything that a team has, and remove the team that is left without anything.

    The other one keeps its name, captain and own limits. What both have submitted counts towards its quotas.

    Raises:
        ServiceError: not an organizer, it is the same team, or one of them does not take part.
    """
    by.require_organizer()
    if team.id == into.id:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"{team.name} cannot be merged with itself; name two teams.")
    # In the order of their ids, so that two merges cannot wait for each other; nobody adds a row to them meanwhile.
    both = list(
        session.scalars(select(Team).where(Team.id.in_([team.id, into.id])).order_by(Team.id).with_for_update())
    )
    if len(both) < 2:
        raise ServiceError(
            ProblemCode.UNKNOWN_TEAM, "One of the teams was merged with another one. Check it and try again."
        )
    for one in both:
        session.refresh(one)
        teams.require_taking_part(one)
    before = {"teams": [team.name, into.name], "merged": str(team.id)}
    moved = _move_submissions(session, team, into)
    _move_members(session, team, into)
    _move_qualifications(session, team, into)
    _move_conflicts(session, team, into)
    _move_briefs_and_attempts(session, team, into)
    for said in (Announcement, Appeal, Question):
        session.execute(update(said).where(said.team_id == team.id).values(team_id=into.id))
    for table in (ApiToken, BoardResult, Invitation, Notice, PartialUpload, Webhook):
        session.execute(update(table).where(table.team_id == team.id).values(team_id=into.id))
    session.expire_all()
    after = {"teams": [into.name], "submissions": moved}
    session.execute(delete(Team).where(Team.id == team.id))
    into.named_at = read_clock(session)
    record(session, by, "team.merge", f"team:{into.id}", after, before=before)


def _move_submissions(session: Session, team: Team, into: Team) -> int:
    """Move all; one whose content the other team has, too, says from whom it is. Return how many there were."""
    theirs = aliased(Submission)
    has_it_too = exists().where(
        theirs.team_id == into.id,
        theirs.merged_from.is_(None),
        theirs.competition == Submission.competition,
        theirs.track == Submission.track,
        theirs.stage == Submission.stage,
        theirs.kind == Submission.kind,
        theirs.digest == Submission.digest,
    )
    ours = update(Submission).where(Submission.team_id == team.id)
    session.execute(
        ours.where(Submission.merged_from.is_(None), has_it_too)
        .values(merged_from=team.id)
        .execution_options(synchronize_session=False)
    )
    moved = session.scalars(
        ours.values(team_id=into.id).returning(Submission.id).execution_options(synchronize_session=False)
    )
    return len(moved.all())


def _move_members(session: Session, team: Team, into: Team) -> None:
    """Move all as members; a name that the other team has, too, gets a number."""
    taken = set(session.scalars(select(Member.name_key).where(Member.team_id == into.id)))
    for member in session.scalars(select(Member).where(Member.team_id == team.id).order_by(Member.joined_at)).all():
        number = 1
        name = member.name
        while teams.name_key(name) in taken:
            number += 1
            name = _numbered(member.name, number)
        taken.add(teams.name_key(name))
        member.name, member.name_key = name, teams.name_key(name)
        member.role, member.team_id = MemberRole.MEMBER, into.id
    session.flush()


def _numbered(name: str, number: int) -> str:
    """Return a name with a number that its key has, too: folding may lengthen a name, and keys are cut."""
    end = f" {number}"
    kept = name[: teams.NAME_LENGTH - len(end)].rstrip()
    while not teams.name_key(kept + end).endswith(end):
        kept = kept[:-1].rstrip()
    return kept + end


def _move_conflicts(session: Session, team: Team, into: Team) -> None:
    """Let judges with a conflict of interest with one team have it with both; a reason against the other one stays."""
    for conflict in session.scalars(select(JudgingConflict).where(JudgingConflict.team_id == team.id)).all():
        kept = insert(JudgingConflict).values(
            team_id=into.id, judge=conflict.judge, reason=conflict.reason, declared_at=conflict.declared_at
        )
        session.execute(kept.on_conflict_do_nothing())
    session.flush()


def _move_briefs_and_attempts(session: Session, team: Team, into: Team) -> None:
    """Move briefs where the other team has none or a declined one; attempts are numbered on from its last."""
    for brief in session.scalars(select(Brief).where(Brief.team_id == team.id)).all():
        theirs = session.get(Brief, (brief.competition, brief.track, brief.stage, into.id))
        if theirs is not None and (theirs.accepted or not brief.accepted):
            continue
        if theirs is not None:
            session.delete(theirs)
            session.flush()
        brief.team_id = into.id
    for result in session.scalars(
        select(EnteredResult).where(EnteredResult.team_id == team.id).order_by(EnteredResult.attempt)
    ).all():
        of_stage = (
            EnteredResult.team_id == into.id,
            EnteredResult.competition == result.competition,
            EnteredResult.track == result.track,
            EnteredResult.stage == result.stage,
        )
        last = session.scalar(select(func.max(EnteredResult.attempt)).where(*of_stage)) or 0
        result.team_id, result.attempt = into.id, last + 1
        session.flush()
    session.flush()


def _move_qualifications(session: Session, team: Team, into: Team) -> None:
    for qualification in session.scalars(select(Qualification).where(Qualification.team_id == team.id)).all():
        kept = insert(Qualification).values(
            competition=qualification.competition,
            track=qualification.track,
            stage=qualification.stage,
            team_id=into.id,
            confirmed_at=qualification.confirmed_at,
        )
        session.execute(kept.on_conflict_do_nothing())
    session.flush()


def forget_contacts(session: Session, settings: Settings, at: datetime | None = None) -> int:
    """Remove people's addresses when all competitions ended long enough ago; return how many. `at`: None is now."""
    days, ends = settings.contacts_kept_days, [one.row.finalized_at for one in Competition.read_all(session)]
    over = [end for end in ends if end is not None]
    if days is None or len(over) < len(ends) or (at or read_clock(session)) < max(over) + timedelta(days=days):
        return 0
    of_members = session.scalars(
        update(Member).where(Member.email.is_not(None)).values(email=None).returning(Member.id)
    )
    session.execute(delete(Notice).where(Notice.channel == NoticeChannel.MAIL))
    of_teams = session.scalars(update(Team).where(Team.contact.is_not(None)).values(contact=None).returning(Team.id))
    forgotten = len(of_members.all()) + len(of_teams.all())
    if forgotten:
        after, before = {"contacts": 0}, {"contacts": forgotten}
        record(session, CONSOLE, "contacts.forget", "competition:contacts", after, before=before)
    return forgotten
