"""How the board of a final list differs from what the same submissions had reached on the live list."""

from collections.abc import Mapping, Sequence
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, aliased, defer
from vitac.evaluator.scoring.score import CombinedScore, Interval, Score, interval_of_difference

from ..database.models import Evaluation, Submission
from ..database.states import EvaluationState
from ..evaluations.scores import combine_scores, read_scores
from ..views.leaderboards import LeaderboardEntryView, LeaderboardView, ShakeUpView


def list_shake_up(session: Session, board: LeaderboardView, at_most: int) -> list[ShakeUpView]:
    """Return the difference between both lists for the first ranked entries of a final list, in the order of its board.

    Args:
        session: of the transaction.
        board: of the final list.
        at_most: number of entries.
    """
    ranked = [entry for entry in board.entries[:at_most] if entry.rank is not None]
    live = _read_live(session, [entry.submission_id for entry in ranked], board.task)
    known = [(entry, live[entry.submission_id]) for entry in ranked if entry.submission_id in live]
    places = [board.ranking.sort_key(board.ranking.values(score, entry.submitted_at)) for entry, score in known]
    by_live = sorted(places)
    return [
        ShakeUpView(
            team=entry.team,
            submission_id=entry.submission_id,
            live_rate=score.success_rate,
            final_rate=entry.success_rate,
            interval=interval_of_difference(_read_final(entry), score),
            live_rank=1 + by_live.index(place),
            final_rank=entry.rank or 0,
        )
        for (entry, score), place in zip(known, places, strict=True)
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
    reached: dict[UUID, Score | CombinedScore] = {}
    for submission, evaluation in rows:
        scores = read_scores(evaluation)
        score = scores.get(task) if task else combine_scores(evaluation, scores)
        if score is not None:
            reached[submission] = score
    return reached


def _read_final(entry: LeaderboardEntryView) -> CombinedScore:
    low, high = entry.success_rate_interval
    return CombinedScore(success_rate=entry.success_rate, interval=Interval(low=low, high=high), mean_steps=None)
