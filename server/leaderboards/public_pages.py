"""Which submissions everybody may see, and their team's say in it; called by API, pages and playbacks.

A public submission is shown to others when its newest evaluation is complete: nobody else sees it wait, run or fail.
"""

from collections.abc import Collection
from uuid import UUID

from sqlalchemy import or_, select
from sqlalchemy.orm import Session, joinedload

from ..audit import record
from ..competitions.competition import Competition
from ..database.engine import among
from ..database.models import Evaluation, Submission, Team
from ..database.states import EvaluationState
from ..errors import not_found, token_missing
from ..evaluations.history import newest_state, select_newest
from ..principals import VISITOR, Principal
from ..visibility import changeable


def readable(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id for somebody who reads its result; a public one is for everybody.

    Raises:
        ServiceError: there is none that the principal may see; visitors are asked for a token, whatever there is.
    """
    submission = session.get(Submission, submission_id, options=[joinedload(Submission.team)])
    if submission is not None:
        may_see = by.may_see(submission.team_id, submission.competition)
        if may_see or public_among(session, [submission.id]):
            return submission
    raise token_missing() if by == VISITOR else not_found("submission", submission_id)


def public_among(session: Session, submissions: Collection[UUID]) -> frozenset[UUID]:
    """Return those of some submissions that everybody may see.

    Left out are disqualified and withdrawn ones, those of disqualified teams, and, while boards are frozen, results
    that these do not show.
    """
    query = (
        select(Submission.id)
        .join(Team)
        .where(
            among(Submission.id, submissions),
            Submission.is_public,
            Team.disqualified_at.is_(None),
            ~Submission.is_off_boards,
            newest_state() == EvaluationState.COMPLETED,
        )
    )
    for competition in Competition.read_all(session):
        if competition.frozen_at is not None:
            is_shown = select_newest(Evaluation.finished_at) <= competition.frozen_at
            query = query.where(or_(~competition.submissions, is_shown))
    return frozenset(session.scalars(query))


def set_public(session: Session, by: Principal, submission_id: UUID, *, public: bool) -> None:
    """Let everybody see the result of a submission, or its team only.

    Raises:
        ServiceError: there is no such submission, or it may only be read.
    """
    submission = changeable(session, by, submission_id)
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    session.refresh(submission, ["is_public"])
    if submission.is_public == public:
        return
    submission.is_public = public
    record(
        session,
        by,
        "submission.publish" if public else "submission.unpublish",
        f"submission:{submission.id}",
        {"public": public},
        before={"public": not public},
    )
