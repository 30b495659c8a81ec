"""The outbox: notices are written in the transaction of their event, and sent later by `sending`."""

import re
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..audit import record
from ..competitions.competition import Competition
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import Evaluation, Member, Notice, Team, Webhook
from ..database.states import NoticeChannel, NoticeKind
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..views.correspondence import NoticeView

MAX_MAILS_A_DAY = 200
"""Maximum e-mails a day to the members of one team."""
MAX_MAILS_A_DAY_TO_ONE = 100
"""Maximum e-mails a day to one address, of all teams together."""
MAX_CONFIRMATIONS = 3
"""Maximum codes to one address within 30 days, of all teams together: it may belong to somebody else."""
MAX_CONFIRMATIONS_OF_TEAM = 60
"""Maximum codes a day that one team has sent to any addresses; it has at most 50 members."""
_TAG = r"\+[^@]*@"
"""What most mail services ignore: `ann+vitac@example.org` is read by `ann@example.org`."""


def announce(session: Session, kind: NoticeKind, team_id: UUID, subject: str, facts: Mapping[str, Any]) -> None:
    """Write a notice to all members and webhooks of a team who want notices of this kind.

    Args:
        session: of the transaction in which it happens; without its commit nothing is sent.
        kind: what happened.
        team_id: to whose team.
        subject: of which thing, `noun:id`: a second notice of the same kind and thing is not written.
        facts: what a webhook gets, as JSON.
    """
    members = session.scalars(
        select(Member).where(
            Member.team_id == team_id, Member.left_at.is_(None), Member.email_confirmed_at.is_not(None)
        )
    )
    targets = [(NoticeChannel.MAIL, one.email) for one in members if one.email and kind.value not in one.muted]
    if targets:
        left = MAX_MAILS_A_DAY - _count_mails(session, timedelta(days=1), Notice.team_id == team_id)
        targets = targets[: max(0, left)]
    targets = [
        (channel, address)
        for channel, address in targets
        if _count_mails(session, timedelta(days=1), _is_to(address)) < MAX_MAILS_A_DAY_TO_ONE
    ]
    hooks = session.scalars(select(Webhook.id).where(Webhook.team_id == team_id))
    targets += [(NoticeChannel.WEBHOOK, str(hook)) for hook in hooks]
    if not targets:
        return
    rows = [
        {"kind": kind, "team_id": team_id, "subject": subject, "channel": channel, "target": target, "facts": facts}
        for channel, target in targets
    ]
    session.execute(insert(Notice).values(rows).on_conflict_do_nothing(constraint="uq_notices_once"))


def ask_to_confirm(session: Session, team_id: UUID, address: str, code: str) -> bool:
    """Write the code that confirms an address to it; return whether no limit of codes is reached."""
    is_one = Notice.kind == NoticeKind.CONFIRMATION
    to_address = _count_mails(session, timedelta(days=30), is_one, _is_to(address))
    of_team = _count_mails(session, timedelta(days=1), is_one, Notice.team_id == team_id)
    if to_address >= MAX_CONFIRMATIONS or of_team >= MAX_CONFIRMATIONS_OF_TEAM:
        return False
    session.add(
        Notice(
            kind=NoticeKind.CONFIRMATION,
            team_id=team_id,
            subject=f"address:{uuid4()}",
            channel=NoticeChannel.MAIL,
            target=address,
            facts={"code": code, "page": "/team"},
        )
    )
    return True


def _is_to(address: str) -> ColumnElement[bool]:
    """Select what the reader of an address gets, however it is written."""
    written = func.regexp_replace(func.lower(Notice.target), _TAG, "@")
    return written == re.sub(_TAG, "@", address.lower())


def _count_mails(session: Session, within: timedelta, *conditions: ColumnElement[bool]) -> int:
    recent = Notice.channel == NoticeChannel.MAIL, Notice.created_at > read_clock(session) - within
    return session.scalar(select(func.count()).select_from(Notice).where(*recent, *conditions)) or 0


def stage_facts(stage: Stage) -> dict[str, str]:
    """Return what a notice of a stage says: names for programs, titles for people."""
    return {
        "track": stage.track,
        "track_title": stage.track_rules.title,
        "stage": stage.name,
        "stage_title": stage.title,
        "page": "/competition",
    }


def announce_evaluation(session: Session, kind: NoticeKind, evaluation: Evaluation) -> None:
    """Say how far an evaluation is; how good it is, the page says to whom may see that."""
    submission = evaluation.submission
    facts = {
        "submission": str(submission.id),
        "name": submission.name,
        "track": submission.track,
        "track_title": Competition.read(session, submission.competition or None).track_title(submission.track),
        "stage": submission.stage or None,
        "evaluation": str(evaluation.id),
        "state": evaluation.state.value,
        "verdict": evaluation.verdict_code,
        "page": f"/submissions/{submission.id}",
    }
    announce(session, kind, submission.team_id, f"evaluation:{evaluation.id}", facts)


def newest(session: Session, limit: int = 100, *, unsent_only: bool = False) -> list[Notice]:
    """Return the newest notices, for organizers."""
    query = select(Notice).order_by(Notice.created_at.desc(), Notice.id).limit(limit)
    return list(session.scalars(query.where(Notice.sent_at.is_(None)) if unsent_only else query))


def notice_view(notice: Notice) -> NoticeView:
    """Return a notice as organizers see it."""
    return NoticeView.model_validate(notice, from_attributes=True)


def retry(session: Session, by: Principal, notice_id: UUID) -> Notice:
    """Send a notice again that was given up.

    Raises:
        ServiceError: not an organizer, there is no such notice, or it was not given up.
    """
    by.require_organizer()
    notice = session.get(Notice, notice_id, with_for_update=True)
    if notice is None:
        raise not_found("notice", notice_id)
    if notice.given_up_at is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Notice {notice_id} was {'sent' if notice.sent_at else 'not given up yet'}; there is nothing to repeat.",
        )
    before = {"given_up": True, "problem": notice.problem}
    notice.given_up_at, notice.attempts, notice.due_at = None, 0, read_clock(session)
    record(session, by, "notice.retry", f"notice:{notice.id}", {"given_up": False}, before=before)
    return notice


NEAR = timedelta(hours=24)


def announce_deadlines(session: Session, at: datetime | None = None) -> None:
    """Write one notice for each stage that closes within a day, to each team that may submit to it.

    A stage whose closing instant is moved gets another one. `at` is the moment, None: now.
    """
    now = at or read_clock(session)
    open_stages = (stage for one in Competition.read_all(session) for stage in one.stages if stage.is_open(now))
    near = [stage for stage in open_stages if stage.rules.closes - now <= NEAR]
    if not near:
        return
    taking_part = select(Team).where(Team.approved_at.is_not(None), Team.disqualified_at.is_(None))
    for team in session.scalars(taking_part).all():
        for stage in near:
            if stage.may_submit(team):
                closes = f"{stage.rules.closes:%F %H:%M} UTC"
                facts = stage_facts(stage) | {"closes": closes}
                announce(session, NoticeKind.DEADLINE, team.id, f"{stage.subject}/{closes}", facts)
