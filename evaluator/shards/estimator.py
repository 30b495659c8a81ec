"""Plays the episodes of a shard with the standard estimator; called by `execution`."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from vitac.errors import VitacError

from ..episodes.episode import make_environment
from ..episodes.records import EpisodeRecord, make_reading
from ..estimator import EstimatorSession, calibrated
from ..figures.figures import FigureChoice, FiguresPart, StartFigures
from ..figures.starts import Measurement, measured_episodes
from ..sensors.made import read_design
from ..tracks import Player
from .order import OrderedShard, ShardResult
from .policy import run_shard

_PROBLEM_CHARACTERS = 500


class NoSensor(VitacError):
    """The standard estimator was to play without a sensor; only submissions of sensors have tasks for it."""


def run_estimator(ordered: OrderedShard, on_episode: Callable[[EpisodeRecord], None]) -> ShardResult:
    """Calibrate the estimator to the order's sensor, or take what the order or this process has, and play the shard.

    Where the order asks for the sensor's figures, they are measured at the starts of its episodes, so that they are
    shared out among the workers as the episodes are.

    Raises:
        NoSensor: the order has none.
        VitacError: the sensor or the environment broke.
    """
    order, task = ordered.order, ordered.task
    if order.sensor is None:
        raise NoSensor(f"Expected a sensor for {task.name}, got none.")
    coefficients = order.coefficients or calibrated(task, order.sensor)
    design = read_design(order.sensor)
    session = EstimatorSession(coefficients, task.definition.action_scale, is_blind=task.player is Player.BLIND)

    def load(_folder: Path, _limits: object) -> nullcontext[EstimatorSession]:
        return nullcontext(session)

    figures = _Figures(Measurement(task, design, coefficients), ordered)

    def played(record: EpisodeRecord) -> None:
        on_episode(record)
        figures.measure(record.episode)

    result = run_shard(
        submission_dir=order.submission,
        track=ordered.track,
        task=task,
        shard=ordered.shard,
        on_episode=played,
        reading=make_reading(task),
        skip=order.skip,
        load_policy=load,
        make_env=partial(make_environment, sensor=design),
    )
    return result.model_copy(update={"coefficients": coefficients, "figures": figures.part()})


class _Figures:
    """Measures a shard's part of the figures, start after start as its episodes end."""

    def __init__(self, measurement: Measurement, ordered: OrderedShard) -> None:
        self._measurement = measurement
        self._choice = ordered.order.figures
        wanted = measured_episodes(ordered.task) if self._choice is FigureChoice.ALL else frozenset[int]()
        self._waiting = {episode.number: episode for episode in ordered.shard.episodes if episode.number in wanted}
        self._starts: dict[int, StartFigures] = {}
        self._problem: str | None = None

    def measure(self, number: int) -> None:
        """Measure at the start of an episode, if it is one of those that figures are taken at."""
        episode = self._waiting.pop(number, None)
        if episode is None:
            return
        try:
            self._starts[number] = self._measurement.start(episode)
        except Exception as error:  # noqa: BLE001 - the score, which the shard is played for, needs no figures
            self._note(f"Start {number}", error)

    def part(self) -> FiguresPart | None:
        """Return all that the shard has to measure; what it has not played this time is measured now.

        What takes no episodes is in the part of every shard, so that it is there whichever are played. What cannot be
        measured is left out, and the part says why: it never fails a shard that was played.
        """
        if self._choice is FigureChoice.NONE:
            return None
        for number in sorted(self._waiting):
            self.measure(number)
        try:
            whole = self._measurement.whole()
        except Exception as error:  # noqa: BLE001 - as above
            whole = FiguresPart(starts=())
            self._note("Touch and grasp", error)
        starts = tuple(self._starts[number] for number in sorted(self._starts))
        return whole.model_copy(update={"starts": starts, "problem": self._problem})

    def _note(self, what: str, error: Exception) -> None:
        """Keep the first reason why something could not be measured."""
        if self._problem is None:
            self._problem = f"{what} could not be measured: {type(error).__name__}: {error}"[:_PROBLEM_CHARACTERS]
