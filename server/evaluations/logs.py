"""What is shown of an uploaded log: its claims, the verdict on it and how models of the team go along with it."""

from collections.abc import Collection
from io import BytesIO
from typing import Any, Self
from uuid import UUID

from pydantic import NonNegativeFloat, NonNegativeInt
from sqlalchemy import select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest, result_hash
from vitac.evaluator.logs.findings import WHY_TOLERATED, LogFinding, VerificationResult
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.logs.text_2025 import WHY_RATES_DIFFER, TextLogSummary
from vitac.evaluator.scoring.score import score
from vitac.evaluator.strict_model import StrictModel

from ..accounts.shown_names import ShownNames
from ..database.models import Evaluation, Shard, Submission
from ..database.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..views.receipts import DivergenceView, LogView
from ..visibility import require_episodes, visible
from .episode_store import EpisodeKey, read_stored_records
from .history import newest_evaluation
from .provenance import read_provenance
from .verdicts import REFUTING_RESULTS


class LogClaim(StrictModel):
    """The claims of a log.

    `submission_digest`, `manifest` and `result_hash` are those of our own logs; `problems` are the sentences about a
    2025 text log whose numbers do not follow from each other.
    """

    team: str | None
    episodes: NonNegativeInt
    successes: NonNegativeInt
    success_rate: NonNegativeFloat
    mean_steps: NonNegativeFloat | None
    submission_digest: str | None = None
    manifest: Manifest | None = None
    result_hash: str | None = None
    problems: tuple[str, ...] = ()

    @classmethod
    def from_log(cls, header: LogHeader, records: Collection[EpisodeRecord]) -> Self:
        """Return what one of our logs claims."""
        return cls(
            team=header.team,
            **score(records).model_dump(include={"episodes", "successes", "success_rate", "mean_steps"}),
            submission_digest=header.submission_digest,
            manifest=header.manifest,
            result_hash=result_hash(header.manifest, records),
        )

    @classmethod
    def from_text_log(cls, summary: TextLogSummary, problems: tuple[str, ...]) -> Self:
        """Return what a text log claims in its last lines."""
        return cls(
            team=summary.team,
            episodes=summary.episodes,
            successes=summary.successes,
            success_rate=summary.claimed_success_rate or 0.0,
            mean_steps=summary.claimed_average_steps,
            problems=problems,
        )

    def stored(self) -> dict[str, Any]:
        """Return the claims as the submission's `manifest` column holds them."""
        return self.model_dump(mode="json")


def log_view(submission: Submission, evaluation: Evaluation, finding: LogFinding | None) -> LogView:
    """Return the claims and verdict of a log, by its newest evaluation and what that found against it.

    Args:
        submission: the log.
        evaluation: its newest one.
        finding: why it is not true.
    """
    claim = LogClaim.model_validate(submission.manifest)
    holds = submission.kind.form.is_verified and evaluation.state is EvaluationState.COMPLETED
    held = read_verification(claim, evaluation) if holds else None
    verdict = finding.verdict if finding else held
    divergence = finding.divergence if finding else None
    return LogView(
        label=submission.kind.form.worth,
        verdict=verdict,
        reason=finding.reason if finding else _reason(verdict, submission),
        divergence=DivergenceView(**divergence.model_dump()) if divergence else None,
        claimed_episodes=claim.episodes,
        claimed_successes=claim.successes,
        claimed_success_rate=claim.success_rate,
        claimed_mean_steps=claim.mean_steps,
        claimed_result_hash=claim.result_hash,
        team_named=claim.team,
        submission_digest_named=claim.submission_digest,
        made_on=claim.manifest.platform_class if claim.manifest else None,
        problems=list(claim.problems),
    )


def make_finding_views(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, LogFinding]:
    """Return what was found first, in list order, against each log whose evaluation ended by it.

    A shard may have found something where the evaluation ended otherwise, as by machines that failed at an earlier one.
    """
    refuted = [evaluation.id for evaluation in evaluations if evaluation.verdict_code in REFUTING_RESULTS]
    if not refuted:
        return {}
    rows = session.execute(
        select(Shard.evaluation_id, Shard.finding)
        .where(Shard.evaluation_id.in_(refuted), Shard.finding.is_not(None))
        .ext(distinct_on(Shard.evaluation_id))
        .order_by(Shard.evaluation_id, Shard.id)
    )
    return {evaluation_id: LogFinding.model_validate(finding) for evaluation_id, finding in rows}


def read_verification(claim: LogClaim, evaluation: Evaluation) -> VerificationResult:
    """Return the verdict on one of our logs whose evaluation is completed, so that nothing was found against it.

    The result hash covers every state: where it is the log's own, no state differs. An evaluation with another one is
    only completed where the task does not repeat to the last bit and all episodes of the log end as it says.
    """
    return (
        VerificationResult.VERIFIED
        if evaluation.result_hash == claim.result_hash
        else VerificationResult.WITHIN_TOLERANCE
    )


def _reason(verdict: VerificationResult | None, submission: Submission) -> str | None:
    if not submission.kind.form.is_verified:
        return WHY_RATES_DIFFER
    if verdict is VerificationResult.VERIFIED:
        return "all states are equal"
    return WHY_TOLERATED if verdict is VerificationResult.WITHIN_TOLERANCE else None


def export_log(session: Session, by: Principal, submission_id: UUID, task: str | None) -> bytes:
    """Return what was played for a submission, to be verified anywhere; a few MB.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: whose newest evaluation.
        task: which one; needed where there are several.

    Raises:
        ServiceError: there is no such submission or task, or its evaluation is not completed.
    """
    submission = visible(session, by, submission_id)
    evaluation = newest_evaluation(session, submission)
    require_episodes(by, evaluation)
    if not submission.kind.form.has_own_log:
        raise ServiceError(
            ProblemCode.NO_LOG, "The re-simulation of a 2025 text log is not an evaluation, so it has no log."
        )
    if evaluation.state is not EvaluationState.COMPLETED:
        raise ServiceError(
            ProblemCode.NO_LOG,
            f"Only a completed evaluation has a log; this one is {evaluation.state}.",
            state=evaluation.state.value,
        )
    chosen = submission.tasks[0] if task is None and len(submission.tasks) == 1 else task
    if chosen not in submission.tasks:
        raise ServiceError(
            ProblemCode.NO_LOG,
            f"A log is of one task: give `task`, one of {', '.join(submission.tasks)}.",
            tasks=submission.tasks,
        )
    header = LogHeader(
        team=ShownNames.read(session, by).show_name(submission.team),
        submission_digest=submission.digest if submission.kind.form.runs_policy else None,
        manifest=read_provenance(session, evaluation, chosen, evaluation.commitment or ""),
    )
    stream = BytesIO()
    write_log(stream, header, read_stored_records(session, EpisodeKey.from_evaluation(evaluation, submission), chosen))
    return stream.getvalue()
