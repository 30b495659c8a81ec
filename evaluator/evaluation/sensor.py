"""A whole evaluation of a sensor with the standard estimator on this machine; called by `vitac sensor evaluate`."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..episodes.episode import make_environment
from ..episodes.records import EpisodeRecord
from ..figures.figures import FigureChoice, SensorFigures, merged
from ..figures.starts import measure_whole
from ..figures.table import list_missing_rows
from ..regression import Coefficients
from ..scoring.comparison import SensingGain, sensing_gain
from ..scoring.score import Rate
from ..sensors.check import accepted_sensor
from ..sensors.made import MadeSensor, made_sensor
from ..shards.order import OnCalibration
from ..strict_model import StrictModel
from ..tracks import Player, load_track
from .local import LocalEvaluation, StoredShards, evaluate

TRACK = "track_3"


class RunReport(Rate):
    """One run of the standard estimator."""

    task: str
    mean_steps: float | None
    result_hash: str


class SensorReport(StrictModel):
    """Scores and sensing gain of a sensor; the digests are those of the service."""

    sensor_digest: str
    coefficients_digest: str
    runs: tuple[RunReport, ...]
    gain: SensingGain
    figures: SensorFigures | None = None
    figures_digest: str | None = None
    not_measured: tuple[str, ...] = ()
    """Why figures that were asked for are not there."""


@dataclass(frozen=True, kw_only=True)
class SensorEvaluation:
    """Both runs of the standard estimator with one sensor.

    Attributes:
        sensor: as it was scored.
        coefficients: what the estimator has learned of it.
        standard: the run that sees the markers.
        blind: the run with all markers at rest.
        figures: of the sensor; None where they were not asked for.
    """

    sensor: MadeSensor
    coefficients: Coefficients
    standard: LocalEvaluation
    blind: LocalEvaluation
    figures: SensorFigures | None

    def report(self) -> SensorReport:
        """Return scores, gain and digests."""
        return SensorReport(
            sensor_digest=self.sensor.digest,
            coefficients_digest=self.coefficients.digest,
            runs=tuple(map(_run, (self.standard, self.blind))),
            gain=sensing_gain(self.standard.records, self.blind.records),
            figures=self.figures,
            figures_digest=None if self.figures is None else self.figures.digest,
            not_measured=tuple(self._not_measured()),
        )

    def _not_measured(self) -> Iterator[str]:
        problems = (part.problem for part in self.blind.figures if part.problem is not None)
        yield from dict.fromkeys(problems)
        if self.figures is not None:
            yield from list_missing_rows(self.figures)


def measure_quickly(folder: Path) -> tuple[str, SensorFigures]:
    """Return the digest of the sensor in a folder, and those of its figures that take no episodes.

    Raises:
        SensorRefused: the sensor breaks a rule.
        SensorRejected: sensor.yaml cannot be used.
    """
    made = made_sensor(accepted_sensor(folder))
    task = next(task for task in load_track(TRACK).tasks.values() if task.player is Player.BLIND)
    design = made.design()
    figures = merged([measure_whole(design, make_environment(task, sensor=design))], [])
    assert figures is not None  # noqa: S101 - the part is whole
    return made.digest, figures


def evaluate_sensor(
    folder: Path,
    *,
    episodes: Iterable[int] | None = None,
    workers: int = 1,
    figures: FigureChoice = FigureChoice.NONE,
    keep: Path | None = None,
    on_episode: Callable[[EpisodeRecord], None] = lambda _: None,
    on_step: Callable[[str], None] = lambda _: None,
    on_calibration: OnCalibration = lambda *_: None,
) -> SensorEvaluation:
    """Make the sensor in a folder and play both runs of the standard estimator.

    Args:
        folder: with sensor.yaml and gel.stl.
        episodes: numbers to play; all by default.
        workers: processes at once.
        figures: which of the sensor's figures are measured, too.
        keep: folder where finished shards are stored and looked for; None keeps none.
        on_episode: gets each record of both runs.
        on_step: gets a few words before what takes seconds and gives no record.
        on_calibration: gets how far the calibration is, from threads.

    Raises:
        SensorRefused: the sensor breaks a rule.
        SensorRejected: sensor.yaml cannot be used.
        UnknownEpisodes: an episode is not in the list.
        ShardProcessFailed: the machine or the simulation broke.
    """
    on_step("meshing the gel")
    made = made_sensor(accepted_sensor(folder))
    on_step("calibrating the standard estimator")
    track, chosen = load_track(TRACK), None if episodes is None else tuple(episodes)
    tasks = {task.player: task for task in track.tasks.values()}
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "sensor.json"
        path.write_bytes(made.as_bytes())
        run = partial(
            evaluate,
            submission_dir=folder,
            track=track,
            episodes=chosen,
            workers=workers,
            sensor=path,
            figures=figures,
            stored=None if keep is None else StoredShards(keep, of=made.digest),
            on_episode=on_episode,
            on_calibration=on_calibration,
        )
        standard = run(task=tasks[Player.ESTIMATOR])
        blind = run(task=tasks[Player.BLIND], coefficients=standard.coefficients)
    assert standard.coefficients is not None  # noqa: S101 - of every run of the estimator
    offsets = [start.offset for start in tasks[Player.BLIND].episode_list.starts]
    return SensorEvaluation(
        sensor=made,
        coefficients=standard.coefficients,
        standard=standard,
        blind=blind,
        figures=merged(blind.figures, offsets),
    )


def _run(evaluation: LocalEvaluation) -> RunReport:
    score, result_hash = evaluation.score, evaluation.result_hash
    assert score is not None  # noqa: S101 - the estimator never fails
    assert result_hash is not None  # noqa: S101
    reached = {name: value for name, value in score if name in RunReport.model_fields}
    return RunReport(task=evaluation.manifest.task, result_hash=result_hash, **reached)
