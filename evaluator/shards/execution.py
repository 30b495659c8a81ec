"""Carries out the order for one shard, in the shard's own process; called by `host`."""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import IO

from vitac.envs.errors import VitacError

from ..episodes.episode import make_environment
from ..episodes.reading import reading_of
from ..episodes.records import EpisodeRecord
from ..sensors.check import design_in
from ..submission.manifest import load_manifest
from ..submission_kinds import SubmissionKind
from ..tracks import Task, Track, load_track
from ..tracks.cut import Shard, cut
from ..tracks.sealed import read_secret, sealed_track
from .log import LogShard, resimulate_log
from .order import ShardMessage, ShardOrder
from .policy import run_shard
from .result import ShardResult
from .text_log import resimulate_text_log

OnEpisode = Callable[[EpisodeRecord], None]
Runner = Callable[[ShardOrder, Track, Task, Shard, OnEpisode], ShardResult]
"""Plays a shard of one kind of submission."""


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


def _result_of(order: ShardOrder, on_episode: OnEpisode) -> ShardResult:
    track = load_track(order.track)
    if order.secret is not None:
        track = sealed_track(track, read_secret(order.secret))
    task = track.tasks[order.task]
    shard = next(shard for shard in cut(task, order.episodes) if shard.index == order.shard)
    return RUNNERS[order.kind](order, track, task, shard, on_episode)


def _run_policy(order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: OnEpisode) -> ShardResult:
    return run_shard(
        submission_dir=order.submission,
        track=track,
        task=task,
        shard=shard,
        on_episode=on_episode,
        reading=reading_of(task, load_manifest(order.submission).observation_keys),
        limits=order.limits,
        slot=order.slot,
        assets_dir=order.assets_dir,
        make_env=partial(make_environment, sensor=design_in(order.sensor) if order.sensor else None),
        skip=order.skip,
        earlier_failures=order.earlier_failures,
    )


def _run_log(order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: OnEpisode) -> ShardResult:
    return resimulate_log(_part(order, track, task, shard), on_episode)


def _run_text_log(order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: OnEpisode) -> ShardResult:
    return resimulate_text_log(_part(order, track, task, shard), on_episode)


def _part(order: ShardOrder, track: Track, task: Task, shard: Shard) -> LogShard:
    return LogShard(log=order.submission, track=track, task=task, shard=shard, skip=order.skip)


RUNNERS: Mapping[SubmissionKind, Runner] = MappingProxyType(
    {
        SubmissionKind.MODEL: _run_policy,
        SubmissionKind.LOG: _run_log,
        SubmissionKind.TEXT_LOG: _run_text_log,
    }
)
