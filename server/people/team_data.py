"""A team's data: all of it to take away, its removal that keeps scores, and when addresses of people are forgotten."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import delete, exists, func, select, update
from sqlalchemy.orm import Session, aliased

from ..accounts import members, teams, tokens
from ..accounts.audit import entry_view, record
from ..accounts.principals import CONSOLE, Principal
from ..db.models import (
    ApiToken,
    Appeal,
    AuditEntry,
    Competition,
    EpisodeResult,
    Evaluation,
    Invitation,
    Member,
    Notice,
    Question,
    Submission,
    Team,
    Webhook,
)
from ..db.states import ACTIVE_EVALUATION_STATES
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import histories
from ..notices.outbox import notice_view
from ..settings import Settings
from ..submissions.view import submission_views
from ..views.contest.people import TeamDataView, WebhookView
from .appeals import appeal_view
from .questions import question_view

REMOVED = "(removed with its team)"


def export(session: Session, settings: Settings, by: Principal, team: Team) -> TeamDataView:
    """Return everything that the service has of a team, as far as the team may see it.

    Raises:
        ServiceError: neither a member nor an organizer asks.
    """
    own = members.own_team_view(session, by, team)
    of_team = select(Submission).where(Submission.team_id == team.id).order_by(Submission.submitted_at, Submission.id)
    runs = histories(session, session.scalars(of_team).all())
    token_rows = session.scalars(select(ApiToken).where(ApiToken.team_id == team.id).order_by(ApiToken.created_at))
    hooks = session.scalars(select(Webhook).where(Webhook.team_id == team.id).order_by(Webhook.created_at))
    notices = session.scalars(select(Notice).where(Notice.team_id == team.id).order_by(Notice.created_at))
    asked = session.scalars(select(Question).where(Question.team_id == team.id).order_by(Question.id))
    appealed = session.scalars(select(Appeal).where(Appeal.team_id == team.id).order_by(Appeal.id))
    lines = session.scalars(select(AuditEntry).where(AuditEntry.subject == f"team:{team.id}").order_by(AuditEntry.id))
    return TeamDataView(
        team=own,
        tokens=[tokens.token_view(one) for one in token_rows],
        submissions=submission_views(session, settings, runs, by) if runs else [],
        webhooks=[WebhookView.model_validate(one, from_attributes=True) for one in hooks],
        notices=[notice_view(one) for one in notices],
        questions=[question_view(one, by) for one in asked],
        appeals=[appeal_view(one, by) for one in appealed],
        audit_log=[entry_view(one) for one in lines],
        made_at=datetime.now(UTC),
    )


def erase(session: Session, by: Principal, team: Team) -> None:
    """Remove a team's name, people, texts and uploads for good; its submissions' names, scores and records stay.

    The uploads themselves are removed by the next housekeeping. Doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or an evaluation of the team waits or runs.
    """
    by.require_organizer()
    teams.lock(session, team)
    session.refresh(team)
    if team.erased_at is not None:
        return
    of_team = select(Submission.id).where(Submission.team_id == team.id)
    active = Evaluation.submission_id.in_(of_team), Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    if running := session.scalar(select(func.count()).select_from(Evaluation).where(*active)):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected no evaluation of {team.name} that waits or runs, got {running}; wait or cancel.",
        )
    now = datetime.now(UTC)
    team.name = f"Deleted team {team.id.hex[:8]}"
    team.name_key, team.contact = teams.name_key(team.name), None
    team.named_at = team.erased_at = now
    _erase_output(session, team)
    session.execute(delete(Question).where(Question.team_id == team.id, ~Question.public))
    session.execute(update(Question).where(Question.team_id == team.id).values(team_id=None))
    session.execute(update(Appeal).where(Appeal.team_id == team.id).values(text=REMOVED))
    for table in (ApiToken, Invitation, Member, Notice, Webhook):
        session.execute(delete(table).where(table.team_id == team.id))
    session.flush()
    record(session, by, "team.delete", f"team:{team.id}", {"erased": True}, before={"erased": False})


def forget_contacts(session: Session, settings: Settings, at: datetime | None = None) -> int:
    """Forget the addresses of people so long after the end of the competition; of how many. `at`: None is now."""
    row = session.get(Competition, 1)
    days = settings.contacts_kept_days
    over = row.finalized_at if row is not None else None
    if days is None or over is None or (at or datetime.now(UTC)) < over + timedelta(days=days):
        return 0
    of_members = session.scalars(
        update(Member).where(Member.email.is_not(None)).values(email=None).returning(Member.id)
    )
    of_teams = session.scalars(update(Team).where(Team.contact.is_not(None)).values(contact=None).returning(Team.id))
    forgotten = len(of_members.all()) + len(of_teams.all())
    if forgotten:
        after, before = {"contacts": 0}, {"contacts": forgotten}
        record(session, CONSOLE, "contacts.forget", "competition:contacts", after, before=before)
    return forgotten


def _erase_output(session: Session, team: Team) -> None:
    """Remove what the policies of a team printed; where another team has the same content, it stays theirs."""
    theirs, ours = aliased(Submission), aliased(Submission)
    mine = exists().where(ours.team_id == team.id, ours.digest == EpisodeResult.submission_digest)
    shared = exists().where(theirs.team_id != team.id, theirs.digest == EpisodeResult.submission_digest)
    session.execute(
        update(EpisodeResult).where(mine, ~shared).values(output="").execution_options(synchronize_session=False)
    )
    session.execute(
        update(Evaluation)
        .where(Evaluation.submission_id.in_(select(Submission.id).where(Submission.team_id == team.id)))
        .values(log_tail="")
        .execution_options(synchronize_session=False)
    )
