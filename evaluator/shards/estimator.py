"""Plays the episodes of a shard with the standard estimator; called by `execution`."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from vitac.envs.errors import VitacError

from ..episodes.episode import make_environment
from ..episodes.reading import reading_of
from ..episodes.records import EpisodeRecord
from ..estimator.calibration import calibrated
from ..estimator.playing import EstimatorSession
from ..sensors.check import design_in
from ..tracks import Player, Task, Track
from ..tracks.cut import Shard
from .order import ShardOrder
from .policy import run_shard
from .result import ShardResult


class NoSensor(VitacError):
    """The standard estimator was to play without a sensor; only submissions of sensors have tasks for it."""


def run_estimator(
    order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: Callable[[EpisodeRecord], None]
) -> ShardResult:
    """Calibrate the estimator to the order's sensor, or take what this process has, and play the shard.

    Raises:
        NoSensor: the order has none.
        VitacError: the sensor or the environment broke.
    """
    if order.sensor is None:
        raise NoSensor(f"Expected a sensor for {task.name}, got none.")
    coefficients = calibrated(task, order.sensor)
    session = EstimatorSession(coefficients, task.definition.action_scale, is_blind=task.player is Player.BLIND)

    def load(_folder: Path, _limits: object, _slot: int) -> nullcontext[EstimatorSession]:
        return nullcontext(session)

    result = run_shard(
        submission_dir=order.submission,
        track=track,
        task=task,
        shard=shard,
        on_episode=on_episode,
        reading=reading_of(task),
        skip=order.skip,
        load_policy=load,
        make_env=partial(make_environment, sensor=design_in(order.sensor)),
    )
    return result.model_copy(update={"coefficients": coefficients})
