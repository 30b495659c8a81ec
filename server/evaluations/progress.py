"""How far evaluations are: finished episodes, place in the queue, time to the end; read once for all that are shown."""

from collections import Counter
from collections.abc import Collection, Mapping
from datetime import timedelta
from types import MappingProxyType
from uuid import UUID

from sqlalchemy import case, func, select
from sqlalchemy.orm import Session

from ..database.models import EpisodeResult, Evaluation, SensorCheck, Shard, Submission
from ..database.states import ACTIVE_EVALUATION_STATES, OPEN_WORK_STATES, EvaluationState, WorkState
from ..database.stored_episodes import ON_ANY_LIST
from ..tracks import known_task
from ..views.evaluations import ProgressView, TaskProgressView
from .episode_store import played_keys

EPISODES_FOR_TIMING = 300
EpisodeCounts = Mapping[str, tuple[int, int]]
"""Finished and successful episodes, by task."""

_NONE: EpisodeCounts = MappingProxyType({})
_TURN = (Evaluation.turn, Evaluation.created_at, Evaluation.id)
"""The order of the queue."""


def count_open(session: Session) -> Counter[EvaluationState]:
    """Return how many evaluations wait and run now."""
    is_open = Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    rows = session.execute(select(Evaluation.state, func.count()).where(is_open).group_by(Evaluation.state))
    return Counter(dict(rows.all()))


def make_progress_view(evaluation: Evaluation, submission: Submission, counts: EpisodeCounts = _NONE) -> ProgressView:
    """Return the finished episodes, by task.

    Args:
        evaluation: whose progress.
        submission: that it evaluates.
        counts: of its stored episodes; not asked once it is scored.
    """
    done = _counts_of_scores(evaluation) or counts

    def count_done(task: str) -> tuple[int, int]:
        return done.get(task, (0, 0))

    tasks = [
        TaskProgressView(
            task=task,
            episodes_done=count_done(task)[0],
            successes=count_done(task)[1],
            episodes_total=count_done(task)[0] if evaluation.scores else _planned(evaluation, submission, task),
        )
        for task in submission.tasks
    ]
    return ProgressView(
        episodes_done=sum(task.episodes_done for task in tasks),
        episodes_total=sum(task.episodes_total for task in tasks),
        episodes_reused=evaluation.episodes_reused,
        successes=sum(successes for _, successes in map(count_done, submission.tasks)),
        tasks=tasks,
    )


def _planned(evaluation: Evaluation, submission: Submission, task: str) -> int:
    """Return how many episodes are played of a task: those of its lists, or of the shards where it was removed."""
    definition = known_task(submission.track, task)
    if definition is not None:
        return len(definition.episodes) * len(played_keys(evaluation, submission))
    return sum(len(shard.episodes) for shard in evaluation.shards if shard.task == task)


def _counts_of_scores(evaluation: Evaluation) -> dict[str, tuple[int, int]]:
    """Return finished and successful episodes by task once all are scored, which spares counting them."""
    return {row["task"]: (row["episodes"], row["successes"]) for row in evaluation.scores or []}


def episode_counts(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, dict[str, tuple[int, int]]]:
    """Return the stored episodes of each evaluation that is not scored."""
    counts: dict[UUID, dict[str, tuple[int, int]]] = {
        evaluation.id: {} for evaluation in evaluations if evaluation.scores is None
    }
    if not counts:
        return counts
    rows = session.execute(
        select(Evaluation.id, EpisodeResult.task, func.count(), func.count().filter(EpisodeResult.success))
        .join(Evaluation.submission)
        .join(EpisodeResult, ON_ANY_LIST)
        .where(Evaluation.id.in_(counts))
        .group_by(Evaluation.id, EpisodeResult.task)
    )
    for evaluation_id, task, episodes, successes in rows:
        counts[evaluation_id][task] = (episodes, successes)
    return counts


def queue_positions(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, int]:
    """Return the place of those that have not started among all that have not, from 1."""
    waiting = [evaluation.id for evaluation in evaluations if evaluation.state is EvaluationState.QUEUED]
    if not waiting:
        return {}
    queue = (
        select(Evaluation.id, func.row_number().over(order_by=_TURN).label("position"))
        .where(Evaluation.state == EvaluationState.QUEUED)
        .subquery()
    )
    rows = session.execute(select(queue.c.id, queue.c.position).where(queue.c.id.in_(waiting)))
    return {evaluation_id: int(position) for evaluation_id, position in rows}


def states_of_checks(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, WorkState]:
    """Return the states of the checks of sensors that are not over, by evaluation."""
    waiting = [evaluation.id for evaluation in evaluations if evaluation.state is EvaluationState.QUEUED]
    if not waiting:
        return {}
    is_open = (SensorCheck.evaluation_id.in_(waiting), SensorCheck.state.in_(OPEN_WORK_STATES))
    return dict(session.execute(select(SensorCheck.evaluation_id, SensorCheck.state).where(*is_open)).all())


def episodes_ahead(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, int]:
    """Return for those that have not ended the episodes in unfinished shards of evaluations whose turn is earlier."""
    active = [evaluation.id for evaluation in evaluations if evaluation.state in ACTIVE_EVALUATION_STATES]
    if not active:
        return {}
    unfinished = func.sum(func.cardinality(Shard.episodes))
    queue = (
        select(Evaluation.id, func.sum(unfinished).over(order_by=_TURN, rows=(None, -1)).label("ahead"))
        .join(Evaluation.shards)
        .where(Shard.state.in_(OPEN_WORK_STATES), Evaluation.state.in_(ACTIVE_EVALUATION_STATES))
        .group_by(*_TURN)
        .subquery()
    )
    rows = session.execute(select(queue.c.id, queue.c.ahead).where(queue.c.id.in_(active)))
    return {evaluation_id: int(ahead or 0) for evaluation_id, ahead in rows}


def mean_episode_s(session: Session, at_once: Mapping[str, int]) -> float | None:
    """Return the mean time [s] that the last episodes of some tasks took of a slot; None where there was none.

    Those of the last week count.

    Args:
        session: of the transaction.
        at_once: how many episodes of each task a slot plays at the same time, in the wall time of one.
    """
    latest = (
        select((EpisodeResult.wall_s / case(dict(at_once), value=EpisodeResult.task)).label("slot_s"))
        .where(EpisodeResult.task.in_(at_once), EpisodeResult.created_at > func.now() - timedelta(days=7))
        .order_by(EpisodeResult.created_at.desc())
        .limit(EPISODES_FOR_TIMING)
        .subquery()
    )
    return session.scalar(select(func.avg(latest.c.slot_s)))


def seconds_to_end(progress: ProgressView, *, ahead: int, slots: int, mean_s: float | None) -> float | None:
    """Return the expected time [s] to the end; None without workers, or before anything was measured.

    Episodes ahead in the queue and our own, times the mean time the last ones took of a slot, over all slots.
    """
    if mean_s is None or not slots:
        return None
    return mean_s * (ahead + progress.episodes_total - progress.episodes_done) / slots
