"""How far an evaluation is: finished episodes, place in the queue, time to the end."""

from datetime import timedelta

from sqlalchemy import ColumnElement, func, select, tuple_
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import load_track
from vitac.server.db.models import EpisodeResult, Evaluation, Shard, Submission
from vitac.server.db.states import ACTIVE_EVALUATION_STATES, OPEN_SHARD_STATES, EvaluationState
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.views.evaluations import ProgressView, TaskProgressView

EPISODES_FOR_TIMING = 300


def progress_of(session: Session, evaluation: Evaluation, submission: Submission) -> ProgressView:
    """Return the finished episodes, by task."""
    done = _counts_of_scores(evaluation) or _counts_of_episodes(session, EpisodeKey.of(evaluation, submission))
    track = load_track(submission.track)
    tasks = [
        TaskProgressView(
            task=task,
            episodes_done=done.get(task, (0, 0))[0],
            successes=done.get(task, (0, 0))[1],
            episodes_total=len(track.tasks[task].episodes),
        )
        for task in submission.tasks
    ]
    return ProgressView(
        episodes_done=sum(task.episodes_done for task in tasks),
        episodes_total=sum(task.episodes_total for task in tasks),
        episodes_reused=evaluation.episodes_reused,
        successes=sum(task.successes for task in tasks),
        tasks=tasks,
    )


def _counts_of_scores(evaluation: Evaluation) -> dict[str, tuple[int, int]]:
    """Return finished and successful episodes by task once all are scored, which spares counting them."""
    return {row["task"]: (row["episodes"], row["successes"]) for row in evaluation.scores or []}


def _counts_of_episodes(session: Session, key: EpisodeKey) -> dict[str, tuple[int, int]]:
    rows = session.execute(
        select(EpisodeResult.task, func.count(), func.count().filter(EpisodeResult.success))
        .where(*key.conditions())
        .group_by(EpisodeResult.task)
    )
    return {task: (episodes, successes) for task, episodes, successes in rows}


def queue_position(session: Session, evaluation: Evaluation) -> int | None:
    """Place among the evaluations that have not started, from 1; None for one that has."""
    if evaluation.state is not EvaluationState.QUEUED:
        return None
    ahead = session.scalar(
        select(func.count())
        .select_from(Evaluation)
        .where(Evaluation.state == EvaluationState.QUEUED, _goes_before(evaluation))
    )
    return 1 + (ahead or 0)


def seconds_to_end(session: Session, evaluation: Evaluation, progress: ProgressView, slots: int) -> float | None:
    """Return the expected time [s] to the end; None when finished, without workers, or before anything was measured.

    Episodes ahead in the queue and our own, times the mean wall time of the last ones, over the workers' slots.
    """
    if evaluation.state not in ACTIVE_EVALUATION_STATES or not slots:
        return None
    mean_s = _mean_episode_s(session, [task.task for task in progress.tasks])
    if mean_s is None:
        return None
    own = progress.episodes_total - progress.episodes_done
    return mean_s * (_episodes_ahead(session, evaluation) + own) / slots


def _mean_episode_s(session: Session, tasks: list[str]) -> float | None:
    latest = (
        select(EpisodeResult.wall_s)
        .where(EpisodeResult.task.in_(tasks), EpisodeResult.created_at > func.now() - timedelta(days=7))
        .order_by(EpisodeResult.created_at.desc())
        .limit(EPISODES_FOR_TIMING)
        .subquery()
    )
    return session.scalar(select(func.avg(latest.c.wall_s)))


def _episodes_ahead(session: Session, evaluation: Evaluation) -> int:
    """Return the episodes in unfinished shards of evaluations whose turn comes earlier."""
    return (
        session.scalar(
            select(func.sum(func.cardinality(Shard.episodes)))
            .join(Evaluation)
            .where(
                Shard.state.in_(OPEN_SHARD_STATES),
                Evaluation.state.in_(ACTIVE_EVALUATION_STATES),
                _goes_before(evaluation),
            )
        )
        or 0
    )


def _goes_before(evaluation: Evaluation) -> ColumnElement[bool]:
    mine = (evaluation.turn, evaluation.created_at, evaluation.id)
    return tuple_(Evaluation.turn, Evaluation.created_at, Evaluation.id) < tuple_(*mine)
