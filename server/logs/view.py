"""What is shown of an uploaded log: its claims, the verdict on it and how models of the team go along with it."""

from sqlalchemy.orm import Session
from vitac.evaluator.logs.findings import LogFinding, VerificationResult
from vitac.server.db.models import Evaluation, Submission
from vitac.server.db.states import EvaluationState
from vitac.server.evaluations.lifecycle import first_refuted_shard
from vitac.server.evaluations.verdicts import REFUTING_RESULTS
from vitac.server.logs.claims import LogClaim
from vitac.server.views.logs import DivergenceView, LogView


def log_view(session: Session, submission: Submission, evaluation: Evaluation) -> LogView:
    """Return the claims and verdict of a log, by its newest evaluation."""
    claim = LogClaim.model_validate(submission.manifest)
    finding = _finding(session, evaluation)
    holds = submission.kind.form.is_verified and evaluation.state is EvaluationState.COMPLETED
    held = verification_of(claim, evaluation) if holds else None
    verdict = finding.verdict if finding else held
    divergence = finding.divergence if finding else None
    return LogView(
        label=submission.kind.form.worth,
        verdict=verdict,
        reason=finding.reason if finding else _reason(verdict, claim),
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


def verification_of(claim: LogClaim, evaluation: Evaluation) -> VerificationResult:
    """Return the verdict on one of our logs whose evaluation is completed, so that nothing was found against it.

    The result hash covers every state: where it is the log's own, no state differs. An evaluation with another one is
    only completed where the log was made on another platform class and all its episodes end as it says.
    """
    return (
        VerificationResult.VERIFIED
        if evaluation.result_hash == claim.result_hash
        else VerificationResult.WITHIN_TOLERANCE
    )


def _finding(session: Session, evaluation: Evaluation) -> LogFinding | None:
    """Return what was found against the log, where the evaluation ended by it.

    A shard may have found something where the evaluation ended otherwise, as by machines that failed at an earlier one.
    """
    if evaluation.verdict_code not in REFUTING_RESULTS:
        return None
    refuted = first_refuted_shard(session, evaluation)
    return LogFinding.model_validate(refuted.finding) if refuted else None


def _reason(verdict: VerificationResult | None, claim: LogClaim) -> str | None:
    if verdict is VerificationResult.VERIFIED:
        return "all states are equal"
    if verdict is VerificationResult.WITHIN_TOLERANCE and claim.manifest:
        return f"made on {claim.manifest.platform_class}; all outcomes are equal"
    return None
