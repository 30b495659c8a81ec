"""Evaluations of another evaluator than the service has, as after an upgrade: restarted with the service's.

Which ones, says the declared rule: those that no worker can finish, or those that have not begun. Of the others an
organizer restarts what no worker can finish.
"""

from collections.abc import Sequence
from functools import partial
from uuid import UUID

import structlog
from sqlalchemy import ColumnElement, Text, and_, func, literal, or_, select
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import list_tracks, load_track
from vitac.evaluator.tracks.registry import current_versions, find_version
from vitac.evaluator.version import evaluator_version

from ..audit import record
from ..database.locks import AdvisoryLock, try_lock, try_lock_evaluation, unless_held
from ..database.models import Evaluation, Submission, Worker
from ..database.states import ACTIVE_EVALUATION_STATES, EvaluationState
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..queue.workers import declared_versions, explain_other_evaluator, is_alive, read_outdated_rule, workers_alive
from ..settings import OutdatedRule, Settings
from . import lifecycle

logger = structlog.get_logger(__name__)

BEGUN_AGAIN_AT_ONCE = 200
"""Each one stays locked to the end: the next sweep takes the rest. They keep their turns."""


def supersede_outdated(session: Session, settings: Settings) -> int:
    """Restart the oldest evaluations that the declared rule names with this process's version; return how many.

    Only while a worker of this version lives, where nothing would be gained otherwise, and only if it is the declared
    one: two versions of the service side by side would take each other's work away.
    """
    if not try_lock(session, AdvisoryLock.SUPERSEDE) or explain_other_evaluator(declared_versions(session)):
        return 0
    if not workers_alive(session, settings, evaluator_version()).alive:
        return 0
    if read_outdated_rule(session) is OutdatedRule.FINISH:
        outdated = _outdated(session, Evaluation.state == EvaluationState.QUEUED)
    else:
        outdated = _outdated(session, is_unserved(settings))
    begun = [unless_held(session, partial(_begin_again, session, evaluation_id)) for evaluation_id in outdated]
    return begun.count(True)


def is_unserved(settings: Settings) -> ColumnElement[bool]:
    """Return the condition that an evaluation is of another evaluator, which no living worker has, and not over."""
    served = select(Worker.evaluator_version).where(is_alive(settings))
    return and_(
        Evaluation.state.in_(ACTIVE_EVALUATION_STATES),
        Evaluation.evaluator_version.not_in(current_versions()),
        Evaluation.evaluator_version.not_in(served),
    )


def restart(session: Session, by: Principal, evaluation_id: UUID) -> None:
    """Restart an evaluation of another evaluator with the one that the service has.

    Raises:
        ServiceError: not an organizer, it has ended, it has this evaluator already, or its task is gone.
    """
    by.require_organizer(by.competition)
    evaluation = session.get_one(Evaluation, evaluation_id)
    if evaluation_id not in _outdated(session, Evaluation.id == evaluation_id):
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE,
            f"Evaluation {evaluation_id} is {evaluation.state}, of evaluator {evaluation.evaluator_version}: expected "
            f"one that waits or runs, of another evaluator than {find_version(evaluation.submission.track)}, with "
            "tasks that the service still has.",
        )
    _begin_again(session, evaluation_id)
    record(session, by, "evaluation.restart", f"evaluation:{evaluation_id}", {"version": evaluation.evaluator_version})


def restart_unserved(session: Session, by: Principal, settings: Settings) -> list[UUID]:
    """Restart all evaluations whose evaluator no living worker has; return which.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    outdated = _outdated(session, is_unserved(settings))
    for evaluation_id in outdated:
        restart(session, by, evaluation_id)
    return list(outdated)


def _outdated(session: Session, *conditions: ColumnElement[bool]) -> Sequence[UUID]:
    # One whose track file is gone, or no longer has its task, waits until it is back.
    known = [(name, literal(list(load_track(name).tasks), ARRAY(Text))) for name in list_tracks()]
    return session.scalars(
        select(Evaluation.id)
        .join(Evaluation.submission)
        .where(
            or_(*(and_(Submission.track == name, tasks.contains(Submission.tasks)) for name, tasks in known)),
            Evaluation.state.in_(ACTIVE_EVALUATION_STATES),
            Evaluation.evaluator_version.not_in(current_versions()),
            *conditions,
        )
        .order_by(Evaluation.created_at, Evaluation.id)
        .limit(BEGUN_AGAIN_AT_ONCE)
    ).all()


def _begin_again(session: Session, evaluation_id: UUID) -> bool:
    evaluation = try_lock_evaluation(session, evaluation_id)
    if evaluation is None or evaluation.state not in ACTIVE_EVALUATION_STATES:
        return False
    current = find_version(evaluation.submission.track)
    lifecycle.cancel(session, evaluation)
    session.flush()
    done_before = session.scalar(
        select(func.max(Evaluation.run)).where(
            Evaluation.submission_id == evaluation.submission_id, Evaluation.evaluator_version == current
        )
    )
    charged_at, evaluation.charged_at = evaluation.charged_at, None
    run = 1 + (done_before or 0)
    lifecycle.start(
        session,
        evaluation.submission,
        run,
        charged_at=charged_at,
        turn=evaluation.turn,
        rejudgement_id=evaluation.rejudgement_id if evaluation.is_proposed else None,
    )
    logger.warning("evaluation_superseded", evaluation=str(evaluation_id), version=evaluation.evaluator_version)
    return True
