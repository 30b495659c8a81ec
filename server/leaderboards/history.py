"""What a team has reached with its submissions so far; called by the pages."""

from functools import cache
from typing import Any

from sqlalchemy import Select, Text, bindparam, func, select, tuple_
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.orm import Session

from ..db.models import BoardResult, Evaluation, Submission
from ..principals import Principal
from ..views.leaderboards import PastResultView
from ..visibility import visible

MAX_RESULTS = 500


def past_results(session: Session, by: Principal, shown: Evaluation) -> list[PastResultView]:
    """Return what the team of an evaluation has reached in its tasks, with submissions of its kind, newest first.

    Results of other evaluator versions and stages are left out: they are not comparable. Nothing before its own result.

    Raises:
        ServiceError: there is no such submission for them.
    """
    submission = visible(session, by, shown.submission_id)
    asked = {
        "evaluation": shown.id,
        "team": submission.team_id,
        "track": submission.track,
        "kind": submission.kind,
        "tasks": submission.tasks,
        "evaluator_version": shown.evaluator_version,
        "at_most": MAX_RESULTS,
    }
    return [PastResultView(**row) for row in session.execute(_results(), asked).mappings()]


@cache
def _results() -> Select[*tuple[Any, ...]]:
    """Return the query of past results, put together once: each page of a submission asks it of its team."""
    own = BoardResult.evaluation_id == bindparam("evaluation")
    stage = select(BoardResult.competition, BoardResult.stage).where(own).limit(1)
    return (
        select(
            BoardResult.board.label("task"),
            BoardResult.submission_id,
            Submission.name.label("submission_name"),
            BoardResult.submitted_at,
            BoardResult.ranked_by["success_rate"].as_float().label("success_rate"),
        )
        .join(Submission, Submission.id == BoardResult.submission_id)
        .where(
            BoardResult.team_id == bindparam("team"),
            BoardResult.track == bindparam("track"),
            BoardResult.kind == bindparam("kind"),
            BoardResult.board == func.any(bindparam("tasks", type_=ARRAY(Text))),
            BoardResult.evaluator_version == bindparam("evaluator_version"),
            tuple_(BoardResult.competition, BoardResult.stage) == stage.scalar_subquery(),
        )
        .order_by(BoardResult.submitted_at.desc(), BoardResult.submission_id)
        .limit(bindparam("at_most"))
    )
