"""Carries out the order for one shard, in the shard's own process; called by `host`."""

from collections.abc import Callable
from typing import IO

from vitac.envs.errors import VitacError

from ..episodes.records import EpisodeRecord
from ..tracks import Task, Track, load_track
from ..tracks.cut import Shard, cut
from .log import LogShard, resimulate_log
from .order import ShardMessage, ShardOrder
from .policy import run_shard
from .result import ShardResult
from .text_log import resimulate_text_log


def execute(order: ShardOrder, answer: IO[str]) -> None:
    """Run the shard and write one line for each episode and one for the end."""

    def send(message: ShardMessage) -> None:
        answer.write(message.model_dump_json(exclude_unset=True) + "\n")
        answer.flush()

    try:
        result = _result_of(order, lambda record: send(ShardMessage(record=record)))
    except VitacError as error:
        send(ShardMessage(error=f"{type(error).__name__}: {error}"))
    else:
        send(ShardMessage(result=result))


def _result_of(order: ShardOrder, on_episode: Callable[[EpisodeRecord], None]) -> ShardResult:
    track = load_track(order.track)
    task = track.tasks[order.task]
    shard = next(shard for shard in cut(task, order.episodes) if shard.index == order.shard)
    if order.submission_dir is None:
        return _resimulate(order, track, task, shard, on_episode)
    return run_shard(
        submission_dir=order.submission_dir,
        track=track,
        task=task,
        shard=shard,
        on_episode=on_episode,
        limits=order.limits,
        slot=order.slot,
        assets_dir=order.assets_dir,
        skip=order.skip,
        earlier_failures=order.earlier_failures,
    )


def _resimulate(
    order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: Callable[[EpisodeRecord], None]
) -> ShardResult:
    log, resimulate = (order.log, resimulate_log) if order.log else (order.text_log, resimulate_text_log)
    assert log is not None  # noqa: S101 - the order names one source
    return resimulate(LogShard(log=log, track=track, task=task, shard=shard, skip=order.skip), on_episode)
