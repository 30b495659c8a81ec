"""What the policy of a submission printed in its episodes, and why it failed in some; called by API and pages."""

from functools import cache
from typing import Any
from uuid import UUID

from sqlalchemy import Row, Select, func, or_, select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome, PolicyFailure

from ..database.models import EpisodeResult, Evaluation
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..views.submissions import EpisodeOutputView, OutputView
from ..visibility import decide_sight, visible

PAGE_EPISODES = 20
_HAS_SOMETHING = or_(
    func.octet_length(EpisodeResult.output) > 0, EpisodeResult.outcome == EpisodeOutcome.POLICY_FAILED.value
)


def episode_outputs(
    session: Session,
    by: Principal,
    submission_id: UUID,
    task: str | None = None,
    *,
    after: int = 0,
    limit: int = PAGE_EPISODES,
) -> OutputView:
    """Return what the policy printed in the episodes of the newest evaluation and why it failed, a page of them.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: of the submission.
        task: one of its tasks; by default the first.
        after: number of the last episode of the page before.
        limit: most episodes of a page.

    Raises:
        ServiceError: there is no such submission, its output is not shown, or it does not play that task.
    """
    submission = visible(session, by, submission_id)
    evaluation = newest_evaluation(session, submission)
    if not decide_sight(by, evaluation).output:
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            "The output of a log, or on a sealed list before it is published, is not shown: ask the organizers if you "
            "need it.",
        )
    task = submission.tasks[0] if task is None else task
    if task not in submission.tasks:
        raise ServiceError(
            ProblemCode.UNKNOWN_TASK, f"Expected one of the tasks {', '.join(submission.tasks)}, got {task!r:.80}."
        )
    rows = session.execute(
        select(
            EpisodeResult.task,
            EpisodeResult.episode,
            EpisodeResult.outcome,
            EpisodeResult.output,
            EpisodeResult.record["failure"].label("failure"),
        )
        .where(*_key(evaluation), EpisodeResult.task == task, EpisodeResult.episode > after, _HAS_SOMETHING)
        .order_by(EpisodeResult.episode)
        .limit(limit + 1)
    ).all()
    return OutputView(
        items=[_view(row) for row in rows[:limit]],
        next_after=rows[limit - 1].episode if len(rows) > limit else None,
    )


def episodes_with_output(session: Session, by: Principal, evaluation: Evaluation) -> int:
    """Return in how many episodes of an evaluation the policy printed something or failed; 0 where it is not shown."""
    if not decide_sight(by, evaluation).output:
        return 0
    return session.scalar(_count_query(), EpisodeKey.from_evaluation(evaluation, evaluation.submission).given()) or 0


@cache
def _count_query() -> Select[int]:
    """Return the query of their number, put together once: each page of a submission asks it."""
    return select(func.count()).select_from(EpisodeResult).where(*EpisodeKey.conditions_given(), _HAS_SOMETHING)


def _view(row: Row[Any]) -> EpisodeOutputView:
    failure = None if row.failure is None else PolicyFailure.model_validate(row.failure)
    return EpisodeOutputView(
        task=row.task,
        episode=row.episode,
        outcome=row.outcome,
        output=row.output,
        failure=None if failure is None else f"{failure.code}: {failure.sentence}",
    )


def _key(evaluation: Evaluation) -> tuple[Any, ...]:
    return EpisodeKey.from_evaluation(evaluation, evaluation.submission).conditions()
