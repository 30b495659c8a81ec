"""Whether the board of a stage is what it will stay: asked before it decides who advances or wins."""

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version

from ..db.models import BoardResult, Evaluation, Submission, Team
from ..db.states import ACTIVE_EVALUATION_STATES
from ..errors import ProblemCode, ServiceError
from .history import of_newest
from .verdicts import ServiceVerdict


def count_running(session: Session, track: str, stage: str) -> int:
    """Return how many evaluations of a stage wait or run."""
    query = select(func.count()).select_from(Evaluation).join(Submission)
    of_stage = (Submission.track == track, Submission.stage == stage)
    return session.scalars(query.where(*of_stage, Evaluation.state.in_(ACTIVE_EVALUATION_STATES))).one()


def require_scored(session: Session, track: str, stage: str) -> None:
    """Refuse while an evaluation of a stage waits or runs, or the newest one of a submission was lost to machines.

    Raises:
        ServiceError: stage_not_over.
    """
    if running := count_running(session, track, stage):
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected no evaluation of stage {stage} of {track} that waits or runs, got {running}; wait or cancel.",
        )
    by_machines = of_newest(Evaluation.verdict_code) == ServiceVerdict.MACHINE_FAILED.value
    if lost := session.scalars(_teams(track, stage).where(by_machines)).all():
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Evaluations of {', '.join(lost)} in stage {stage} of {track} were lost to machines; requeue them, and "
            "cancel what cannot run.",
        )


def require_current(session: Session, track: str, stage: str) -> None:
    """Refuse while a model of a stage has a result of another evaluator version and was not evaluated again since.

    Raises:
        ServiceError: results_outdated.
    """
    has_result = select(BoardResult).where(BoardResult.submission_id == Submission.id).exists()
    is_stale = of_newest(Evaluation.evaluator_version) != evaluator_version()
    models = _teams(track, stage).where(Submission.kind == SubmissionKind.MODEL, has_result, is_stale)
    if stale := session.scalars(models).all():
        raise ServiceError(
            ProblemCode.RESULTS_OUTDATED,
            f"In stage {stage} of {track} results of {', '.join(stale)} were made by another evaluator version, so "
            "they cannot be compared. Requeue them.",
        )


def _teams(track: str, stage: str) -> Select[str]:
    """Return the names of the teams with a submission to a stage; disqualified ones hold nobody up."""
    of_stage = (Submission.track == track, Submission.stage == stage, Team.disqualified_at.is_(None))
    return select(Team.name).join(Submission).where(*of_stage).distinct().order_by(Team.name)
