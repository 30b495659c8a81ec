"""Carries out orders for shards, one after the other, in a process of their own; called by `host`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import IO, TYPE_CHECKING

from vitac.envs.errors import VitacError

from ..agent.isolation.interpreter import installed_packages
from ..episodes.episode import make_environment
from ..episodes.reading import make_reading
from ..episodes.records import EpisodeRecord
from ..sensors.made import read_design
from ..submission.manifest import load_manifest
from ..submission_kinds import SubmissionKind
from ..tracks import Player, Task, Track
from ..tracks.cut import Shard, cut
from ..tracks.sealed import load_played_track, read_secret
from ..tracks.versions import find_version
from .batch import run_batches
from .estimator import run_estimator
from .log import LogShard, resimulate_log
from .order import ShardMessage, ShardOrder
from .policy import load_in_sandbox, run_shard
from .preparation import Preparation
from .result import ShardResult
from .text_log import resimulate_text_log

if TYPE_CHECKING:
    from vitac.envs.tactile.design import SensorDesign


class OtherEvaluator(VitacError):
    """The process of a shard has another evaluator than the evaluation began with; start its worker again."""


OnEpisode = Callable[[EpisodeRecord], None]


@dataclass(frozen=True, kw_only=True)
class OrderedShard:
    """An order with what it names."""

    order: ShardOrder
    track: Track
    task: Task
    shard: Shard


Runner = Callable[[OrderedShard, Preparation, OnEpisode], ShardResult]
"""Plays a shard of one kind of submission."""


def execute(order: ShardOrder, answer: IO[str], preparation: Preparation) -> None:
    """Run the shard and write one line for each episode and one for the end.

    Args:
        order: what to run.
        answer: gets the lines.
        preparation: environment and loaded policy of the orders before this one.
    """

    def send(message: ShardMessage) -> None:
        answer.write(message.model_dump_json(exclude_unset=True) + "\n")
        answer.flush()

    try:
        result = _make_result(order, preparation, send)
    except VitacError as error:
        preparation.forget()  # whoever reads the error kills this process, which could not clear up itself
        send(ShardMessage(error=f"{type(error).__name__}: {error}"))
    else:
        send(ShardMessage(result=result))


def _make_result(order: ShardOrder, preparation: Preparation, send: Callable[[ShardMessage], None]) -> ShardResult:
    if order.evaluator_version not in {None, find_version(order.track)}:
        raise OtherEvaluator(
            f"Expected evaluator {order.evaluator_version}, got {find_version(order.track)}: the installation was "
            "replaced under a running worker. Start the worker again."
        )
    track = load_played_track(order.track, read_secret(order.secret) if order.secret else None)
    task = track.tasks[order.task]
    shard = next(shard for shard in cut(task, order.episodes) if shard.index == order.shard)
    ordered = OrderedShard(order=order, track=track, task=task, shard=shard)
    runner = RUNNERS[order.kind] if task.player is Player.POLICY else _run_estimator
    if runner is _run_policy:
        send(ShardMessage(packages=dict(installed_packages(track.packages).versions)))
    return runner(ordered, preparation, lambda record: send(ShardMessage(record=record)))


def _run_policy(ordered: OrderedShard, preparation: Preparation, on_episode: OnEpisode) -> ShardResult:
    order = ordered.order
    load = partial(load_in_sandbox, packages=ordered.track.packages, episode_period_s=order.episode_period_s)
    if ordered.task.definition.batch_size > 1:
        return run_batches(order, ordered.track, ordered.task, ordered.shard, on_episode, load)
    preparation.begin(order)
    return run_shard(
        submission_dir=order.submission,
        track=ordered.track,
        task=ordered.task,
        shard=ordered.shard,
        on_episode=on_episode,
        reading=make_reading(ordered.task, load_manifest(order.submission).observation_keys),
        limits=order.limits,
        assets_dir=order.assets_dir,
        load_policy=partial(preparation.policy, load),
        make_env=partial(preparation.environment, partial(make_environment, sensor=_find_sensor(order))),
        skip=order.skip,
        failures=list(order.earlier_failures),
    )


def _run_estimator(ordered: OrderedShard, _: Preparation, on_episode: OnEpisode) -> ShardResult:
    return run_estimator(ordered.order, ordered.track, ordered.task, ordered.shard, on_episode)


def _find_sensor(order: ShardOrder) -> "SensorDesign | None":
    return read_design(order.sensor) if order.sensor else None


def _run_log(ordered: OrderedShard, _: Preparation, on_episode: OnEpisode) -> ShardResult:
    return resimulate_log(_part(ordered), on_episode)


def _run_text_log(ordered: OrderedShard, _: Preparation, on_episode: OnEpisode) -> ShardResult:
    return resimulate_text_log(_part(ordered), on_episode)


def _part(ordered: OrderedShard) -> LogShard:
    order = ordered.order
    return LogShard(log=order.submission, track=ordered.track, task=ordered.task, shard=ordered.shard, skip=order.skip)


RUNNERS: Mapping[SubmissionKind, Runner] = MappingProxyType(
    {
        SubmissionKind.MODEL: _run_policy,
        SubmissionKind.LOG: _run_log,
        SubmissionKind.TEXT_LOG: _run_text_log,
    }
)
