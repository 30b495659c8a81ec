"""What a team has reached with its submissions so far; called by the pages."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..accounts.principals import Principal
from ..accounts.visibility import visible
from ..db.models import BoardResult, Evaluation, Submission
from ..views.leaderboards import PastResultView

MAX_RESULTS = 500


def past_results(session: Session, by: Principal, shown: Evaluation) -> list[PastResultView]:
    """Return what the team of an evaluation has reached in its tasks, with submissions of its kind, newest first.

    Results of other evaluator versions and stages are left out: they are not comparable. Nothing before its own result.

    Raises:
        ServiceError: there is no such submission for them.
    """
    submission = visible(session, by, shown.submission_id)
    stage = select(BoardResult.stage).where(BoardResult.evaluation_id == shown.id).limit(1).scalar_subquery()
    rows = session.execute(
        select(
            BoardResult.board.label("task"),
            BoardResult.submission_id,
            Submission.name.label("submission_name"),
            BoardResult.submitted_at,
            BoardResult.success_rate,
        )
        .join(Submission, Submission.id == BoardResult.submission_id)
        .where(
            BoardResult.team_id == submission.team_id,
            BoardResult.track == submission.track,
            BoardResult.kind == submission.kind,
            BoardResult.board.in_(submission.tasks),
            BoardResult.evaluator_version == shown.evaluator_version,
            BoardResult.stage == stage,
        )
        .order_by(BoardResult.submitted_at.desc(), BoardResult.submission_id)
        .limit(MAX_RESULTS)
    )
    return [PastResultView(**row) for row in rows.mappings()]
