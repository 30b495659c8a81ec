"""Whether the board of a stage is what it will stay: asked before it decides who advances or wins."""

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import POLICY_KINDS
from vitac.evaluator.tracks.registry import find_version

from ..competitions.stages import Stage
from ..database.models import BoardResult, Evaluation, Submission, Team
from ..database.states import ACTIVE_EVALUATION_STATES
from ..errors import ProblemCode, ServiceError
from .history import select_newest
from .verdicts import ServiceVerdict


def count_running(session: Session, stage: Stage) -> int:
    """Return how many evaluations of a stage wait or run."""
    query = select(func.count()).select_from(Evaluation).join(Submission)
    return session.scalars(query.where(stage.submissions, Evaluation.state.in_(ACTIVE_EVALUATION_STATES))).one()


def require_scored(session: Session, stage: Stage) -> None:
    """Refuse while an evaluation of a stage waits or runs, or the newest one of a submission was lost to machines.

    Raises:
        ServiceError: stage_not_over.
    """
    if running := count_running(session, stage):
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected no evaluation of {stage} that waits or runs, got {running}; wait or cancel.",
        )
    by_machines = select_newest(Evaluation.verdict_code) == ServiceVerdict.MACHINE_FAILED.value
    if lost := session.scalars(_teams(stage).where(by_machines)).all():
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Evaluations of {', '.join(lost)} in {stage} were lost to machines; requeue them, and "
            "cancel what cannot run.",
        )


def require_current(session: Session, stage: Stage) -> None:
    """Refuse while a model of a stage has a result of another evaluator version and was not evaluated again since.

    Raises:
        ServiceError: results_outdated.
    """
    has_result = select(BoardResult).where(BoardResult.submission_id == Submission.id).exists()
    is_stale = select_newest(Evaluation.evaluator_version) != find_version(stage.track)
    models = _teams(stage).where(Submission.kind.in_(POLICY_KINDS), has_result, is_stale)
    if stale := session.scalars(models).all():
        raise ServiceError(
            ProblemCode.RESULTS_OUTDATED,
            f"In {stage} results of {', '.join(stale)} were made by another evaluator version, so "
            "they cannot be compared. Requeue them.",
        )


def _teams(stage: Stage) -> Select[str]:
    """Return the names of the teams with a submission to a stage; what is disqualified holds nobody up."""
    taking_part = Team.disqualified_at.is_(None), Submission.disqualified_at.is_(None)
    return select(Team.name).join(Submission).where(stage.submissions, *taking_part).distinct().order_by(Team.name)
