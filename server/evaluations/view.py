"""Makes the view of an evaluation out of its rows; called where submissions and evaluations are shown."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Self
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.server.db.states import TERMINAL_EVALUATION_STATES

from ..db.models import EpisodeResult, Evaluation, Submission
from ..queue.workers import WorkersAlive
from ..views.evaluations import DifferingEpisodeView, EvaluationSummaryView, EvaluationView, VerdictView
from .differences import differing_episodes
from .episode_store import EpisodeKey
from .lifecycle import LOG_TAIL_CHARACTERS
from .progress import progress_of, queue_position, seconds_to_end
from .provenance import isolation_levels
from .scores import bounds, combined_score, score_views
from .verdicts import sentence_of


@dataclass(frozen=True, kw_only=True)
class EvaluationRows:
    """What the views of evaluations show out of other tables, by evaluation, read once for all of them.

    Attributes:
        isolation: how policies were isolated.
        differing: episodes that were run again with another record; None where only organizers may see them.
    """

    isolation: Mapping[UUID, list[str]]
    differing: Mapping[UUID, list[DifferingEpisodeView]] | None

    @classmethod
    def read(cls, session: Session, evaluations: Collection[Evaluation], *, for_organizer: bool) -> Self:
        """Return what is shown of these evaluations."""
        return cls(
            isolation=isolation_levels(session, evaluations),
            differing=differing_episodes(session, evaluations) if for_organizer else None,
        )


def evaluation_view(
    session: Session, evaluation: Evaluation, workers: WorkersAlive, rows: EvaluationRows
) -> EvaluationView:
    """Return an evaluation as it is shown.

    Args:
        session: of the transaction.
        evaluation: whose view.
        workers: those alive of its evaluator version.
        rows: of this evaluation among others.
    """
    submission = evaluation.submission
    progress = progress_of(session, evaluation, submission)
    combined = combined_score(evaluation)
    return EvaluationView(
        **dict(summary_view(evaluation)),
        started_at=evaluation.started_at,
        queue_position=queue_position(session, evaluation),
        eta_s=seconds_to_end(session, evaluation, progress, workers.slots),
        progress=progress,
        verdict=verdict_view(evaluation),
        log_tail=_log_tail(session, evaluation, submission),
        success_rate=combined.success_rate if combined else None,
        success_rate_interval=bounds(combined.interval) if combined else None,
        mean_steps=combined.mean_steps if combined else None,
        scores=score_views(evaluation),
        evaluator_hash=evaluation.evaluator_hash,
        platform_class=evaluation.platform_class,
        isolation=rows.isolation[evaluation.id],
        differing_episodes=None if rows.differing is None else rows.differing[evaluation.id],
    )


def summary_view(evaluation: Evaluation) -> EvaluationSummaryView:
    """Return an evaluation as a line of its submission's history."""
    return EvaluationSummaryView.model_validate(evaluation, from_attributes=True)


def verdict_view(evaluation: Evaluation) -> VerdictView | None:
    """Return why an evaluation has no score; None for one that has, or that goes on."""
    if evaluation.verdict_code is None:
        return None
    return VerdictView(
        code=evaluation.verdict_code,
        title=sentence_of(evaluation.verdict_code),
        message=evaluation.verdict_message or "",
        task=evaluation.verdict_task,
        episode=evaluation.verdict_episode,
    )


def _log_tail(session: Session, evaluation: Evaluation, submission: Submission) -> str:
    """Return what was kept at the end; while it runs, the output of the last episode that the policy failed in.

    Nothing for a log: no policy ran here, and the output that a log names could be anything.
    """
    if not submission.kind.form.runs_policy:
        return ""
    if evaluation.state in TERMINAL_EVALUATION_STATES:
        return evaluation.log_tail
    tail = session.scalar(
        select(EpisodeResult.record["failure"]["output_tail"].astext)
        .where(*EpisodeKey.of(evaluation, submission).conditions(), EpisodeResult.outcome == "policy_failed")
        .order_by(EpisodeResult.created_at.desc())
        .limit(1)
    )
    return (tail or "")[-LOG_TAIL_CHARACTERS:]
