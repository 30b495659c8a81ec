"""Evaluations that wait for an evaluator that no worker runs, as after an upgrade: started again with today's."""

from collections.abc import Sequence
from functools import partial
from uuid import UUID

import structlog
from sqlalchemy import Text, and_, func, literal, or_, select
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import list_tracks, load_track
from vitac.evaluator.tracks.versions import current_versions, find_version
from vitac.evaluator.version import evaluator_version

from ..db.advisory_locks import AdvisoryLock, try_lock
from ..db.models import Evaluation, Submission, Worker
from ..db.row_locks import try_lock_evaluation, unless_held
from ..db.states import ACTIVE_EVALUATION_STATES
from ..queue.workers import is_alive, workers_alive
from ..settings import Settings
from . import lifecycle

logger = structlog.get_logger(__name__)

BEGUN_AGAIN_AT_ONCE = 200
"""Each one stays locked to the end: the next sweep takes the rest. They keep their turns."""


def supersede_outdated(session: Session, settings: Settings) -> int:
    """Begin the oldest evaluations of versions without a worker again with this process's version; how many.

    Only while a worker of this version lives: otherwise nothing would be gained, and two versions of the service side
    by side would take each other's work away.
    """
    if not try_lock(session, AdvisoryLock.SUPERSEDE):
        return 0
    if not workers_alive(session, settings, evaluator_version()).alive:
        return 0
    outdated = _outdated(session, settings)
    begun = [unless_held(session, partial(_begin_again, session, evaluation_id)) for evaluation_id in outdated]
    return begun.count(True)


def _outdated(session: Session, settings: Settings) -> Sequence[UUID]:
    served = select(Worker.evaluator_version).where(is_alive(settings))
    # One whose track file is gone, or no longer has its task, waits until it is back.
    known = [(name, literal(list(load_track(name).tasks), ARRAY(Text))) for name in list_tracks()]
    return session.scalars(
        select(Evaluation.id)
        .join(Evaluation.submission)
        .where(
            or_(*(and_(Submission.track == name, tasks.contains(Submission.tasks)) for name, tasks in known)),
            Evaluation.state.in_(ACTIVE_EVALUATION_STATES),
            Evaluation.evaluator_version.not_in(current_versions()),
            Evaluation.evaluator_version.not_in(served),
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
