"""What is shown of an uploaded log: its claims, the verdict on it and how models of the team go along with it."""

from collections.abc import Collection
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session
from vitac.evaluator.logs.findings import LogFinding, VerificationResult, explain_tolerated
from vitac.evaluator.logs.text_2025 import WHY_RATES_DIFFER

from ..database.models import Evaluation, Shard, Submission
from ..database.states import EvaluationState
from ..evaluations.verdicts import REFUTING_RESULTS
from ..tracks import known_task
from ..views.logs import DivergenceView, LogView
from .claims import LogClaim


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
        reason=finding.reason if finding else _reason(verdict, claim, submission),
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
    only completed where the log was made on another platform class and all its episodes end as it says.
    """
    return (
        VerificationResult.VERIFIED
        if evaluation.result_hash == claim.result_hash
        else VerificationResult.WITHIN_TOLERANCE
    )


def _reason(verdict: VerificationResult | None, claim: LogClaim, submission: Submission) -> str | None:
    if not submission.kind.form.is_verified:
        return WHY_RATES_DIFFER
    if verdict is VerificationResult.VERIFIED:
        return "all states are equal"
    if verdict is VerificationResult.WITHIN_TOLERANCE and claim.manifest:
        task = known_task(submission.track, submission.tasks[0])
        return explain_tolerated(task, claim.manifest.platform_class) if task else None
    return None
