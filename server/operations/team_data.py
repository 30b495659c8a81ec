"""A team's data: all of it to take away, and its removal that keeps scores."""

import secrets
from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy import delete, func, or_, select, update
from sqlalchemy.orm import Session

from ..accounts import members, teams, tokens, webhooks
from ..accounts.messages import make_announcement_view, make_question_view
from ..accounts.outbox import notice_view
from ..audit import entry_view, record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import (
    Announcement,
    ApiToken,
    Appeal,
    AuditEntry,
    Brief,
    CompetitionRow,
    Evaluation,
    Invitation,
    Member,
    Notice,
    Question,
    Submission,
    Team,
    Webhook,
)
from ..database.states import ACTIVE_EVALUATION_STATES, Role
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import histories
from ..principals import Principal
from ..settings import Settings
from ..submissions.appeals import appeal_view
from ..submissions.briefs import brief_view
from ..submissions.listing import submission_views
from ..submissions.withdrawal import REMOVED, erase_output
from ..views.team_data import TeamDataView
from ..views.teams import AuditEntryView

_ACTIONS = ("team.", "member.")
"""Actions whose audit lines members get; conflicts of interest of judges, for example, are not for the team."""
_CAPTAINS_ACTIONS = ("webhook.",)


def export(session: Session, settings: Settings, by: Principal, team: Team) -> TeamDataView:
    """Return everything that the service has of a team, as far as who asks may see it.

    An organizer gets what the captain would: it is to be handed to the team, so it says nothing of sealed lists.

    Raises:
        ServiceError: neither a member nor an organizer asks.
    """
    own = members.own_team_view(session, by, team)
    if by.organizes_service:
        by = Principal(role=Role.TEAM, team_id=team.id, team_name=team.name, leads_team=True)
    of_team = select(Submission).where(Submission.team_id == team.id).order_by(Submission.submitted_at, Submission.id)
    runs = histories(session, session.scalars(of_team).all())
    notices = session.scalars(select(Notice).where(Notice.team_id == team.id).order_by(Notice.created_at))
    messages = session.scalars(
        select(Announcement).where(Announcement.team_id == team.id, Announcement.withdrawn_at.is_(None))
    )
    asked = session.scalars(select(Question).where(Question.team_id == team.id).order_by(Question.id))
    handed_in = session.scalars(select(Brief).where(Brief.team_id == team.id).order_by(Brief.received_at))
    appealed = session.scalars(select(Appeal).where(Appeal.team_id == team.id).order_by(Appeal.id))
    return TeamDataView(
        team=own,
        tokens=[tokens.token_view(one) for one in tokens.list_tokens(session, by)],
        submissions=submission_views(session, settings, runs, by) if runs else [],
        webhooks=webhooks.list_webhooks(session, by, team) if by.leads_team else [],
        notices=[notice_view(one) for one in notices],
        messages=[make_announcement_view(one) for one in messages],
        questions=[make_question_view(one, by) for one in asked],
        appeals=[appeal_view(one, by) for one in appealed],
        briefs=[brief_view(one) for one in handed_in],
        audit_log=_audit_log(session, by, team),
        made_at=read_clock(session),
    )


def erase(session: Session, by: Principal, team: Team) -> None:
    """Remove a team's name, members, texts and uploads permanently; its submissions' names, scores and records stay.

    The uploads themselves are removed by the next housekeeping. Doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or an evaluation of the team waits or runs.
    """
    by.require_organizer()
    session.refresh(team)
    if team.erased_at is not None:
        return
    teams.lock(session, team)
    of_team = select(Submission.id).where(Submission.team_id == team.id)
    active = Evaluation.submission_id.in_(of_team), Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    if running := session.scalar(select(func.count()).select_from(Evaluation).where(*active)):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected no evaluation of {team.name} that waits or runs, got {running}; wait or cancel.",
        )
    now = read_clock(session)
    team.name = f"Deleted team {secrets.token_hex(16)}"  # nobody can have taken this name before
    team.name_key, team.contact, team.note = teams.name_key(team.name), None, ""
    team.named_at = team.erased_at = now
    erase_output(session, Submission.team_id == team.id)
    session.execute(update(Submission).where(Submission.team_id == team.id).values(description=None))
    _rename_in_final_results(session, team)
    session.execute(update(Brief).where(Brief.team_id == team.id).values(content=b""))  # what was decided stays
    session.execute(delete(Question).where(Question.team_id == team.id, ~Question.public))
    session.execute(update(Question).where(Question.team_id == team.id).values(team_id=None))
    session.execute(update(Appeal).where(Appeal.team_id == team.id).values(text=REMOVED))
    for table in (Announcement, ApiToken, Invitation, Member, Notice, Webhook):
        session.execute(delete(table).where(table.team_id == team.id))
    session.flush()
    record(session, by, "team.delete", f"team:{team.id}", {"erased": True}, before={"erased": False})


def _rename_in_final_results(session: Session, team: Team) -> None:
    """Write a team's present name into winners and boards that were stored at the end of the competition."""
    own = {
        str(submission_id)
        for submission_id in session.scalars(select(Submission.id).where(Submission.team_id == team.id))
    }
    for name in sorted(competition.name for competition in Competition.read_all(session)):
        _rename_in_results(Competition.lock(session, name).row, team, own)


def _rename_in_results(row: CompetitionRow, team: Team, own: Collection[str]) -> None:
    """Write a team's name into what was stored of its submissions and attempts."""
    if row.boards is None:
        return
    before = {entry["team"] for board in row.boards for entry in board["entries"] if entry["submission_id"] in own}

    def renamed(kept: Mapping[str, Any]) -> dict[str, Any]:
        is_own = kept["team"] in before or kept.get("team_id") == str(team.id)
        return {**kept, "team": team.name} if is_own else dict(kept)

    row.boards = [board | {"entries": [renamed(entry) for entry in board["entries"]]} for board in row.boards]
    row.winners = [renamed(winner) for winner in row.winners or ()]


def _audit_log(session: Session, by: Principal, team: Team) -> list[AuditEntryView]:
    """Return what people changed of the team; the contact of a team that was merged into it is not theirs."""
    actions = (*_ACTIONS, *_CAPTAINS_ACTIONS) if by.leads_team else _ACTIONS
    known = or_(*(AuditEntry.action.startswith(action) for action in actions))
    lines = session.scalars(
        select(AuditEntry).where(AuditEntry.subject == f"team:{team.id}", known).order_by(AuditEntry.id)
    )
    views = [entry_view(one) for one in lines]
    return [
        one.model_copy(update={"before": {key: value for key, value in one.before.items() if key != "contact"}})
        if one.before
        else one
        for one in views
    ]
