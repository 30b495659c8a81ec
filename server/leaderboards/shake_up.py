"""How the board of a final list differs from what the same submissions had reached on the live list."""

from collections.abc import Mapping, Sequence
from math import hypot
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, aliased, defer
from vitac.evaluator.scoring.score import CombinedScore, Score

from ..database.models import Evaluation, Submission
from ..database.states import EvaluationState
from ..evaluations.scores import combine_scores, read_scores
from ..views.leaderboards import LeaderboardEntryView, ShakeUpView


def list_shake_up(
    session: Session, entries: Sequence[LeaderboardEntryView], task: str | None = None
) -> list[ShakeUpView]:
    """Return the difference between both lists for each ranked entry of a final list, in the order of its board.

    Args:
        session: of the transaction.
        entries: of the board.
        task: whose board; None: of all tasks together.
    """
    ranked = [entry for entry in entries if entry.rank is not None]
    live = _read_live(session, [entry.submission_id for entry in ranked], task)
    known = [(entry, live[entry.submission_id]) for entry in ranked if entry.submission_id in live]
    by_live = sorted((rate.success_rate for _, rate in known), reverse=True)
    return [
        ShakeUpView(
            team=entry.team,
            submission_id=entry.submission_id,
            live_rate=rate.success_rate,
            final_rate=entry.success_rate,
            interval=_difference_interval(rate, entry),
            live_rank=1 + by_live.index(rate.success_rate),
            final_rank=entry.rank or 0,
        )
        for entry, rate in known
    ]


def _read_live(session: Session, submissions: Sequence[UUID], task: str | None) -> Mapping[UUID, Score | CombinedScore]:
    """Return what the chosen ones behind submissions to a final list had reached, by the submission to that list."""
    chosen = aliased(Submission)
    rows = session.execute(
        select(Submission.id, Evaluation)
        .join(chosen, chosen.id == Submission.final_of)
        .join(Evaluation, Evaluation.submission_id == chosen.id)
        .where(Submission.id.in_(submissions), ~Evaluation.is_proposed, Evaluation.state == EvaluationState.COMPLETED)
        .order_by(Evaluation.created_at, Evaluation.run)
        .options(defer(Evaluation.log_tail))
    )
    found: dict[UUID, Score | CombinedScore] = {}
    for submission, evaluation in rows:
        scores = read_scores(evaluation)
        score = scores.get(task) if task else combine_scores(evaluation, scores)
        if score is not None:
            found[submission] = score
    return found


def _difference_interval(live: Score | CombinedScore, final: LeaderboardEntryView) -> tuple[float, float]:
    """Return the 95 % interval of the final rate minus the live one, which are of different episodes.

    R. G. Newcombe, Interval estimation for the difference between independent proportions, Statistics in Medicine 17
    (1998) 873-890, method 10, of the intervals of both rates.
    """
    difference = final.success_rate - live.success_rate
    low, high = final.success_rate_interval
    return (
        difference - hypot(final.success_rate - low, live.interval.high - live.success_rate),
        difference + hypot(high - final.success_rate, live.success_rate - live.interval.low),
    )
