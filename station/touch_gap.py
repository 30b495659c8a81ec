"""How far what a station felt and saw in its trials is from our simulation of the same motions."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.scene.gripper import SensorPose
from vitac.errors import VitacError
from vitac.evaluator.scoring.gap import Measured
from vitac.evaluator.strict_model import StrictModel

from .perception.markers import MarkerFlow
from .perception.observation import MIDDLE_REGION, mean_by_region
from .rehearsal import AttemptRecord, RehearsalReport
from .twin.gel_view import PrintedMarkers, marker_grid, see_through_lens
from .twin.grasp import Axes, HeldPeg, Mounted, hold_peg, in_world
from .twin.hidden import HiddenSettings
from .twin.structure import twin_gel

FloatArray = NDArray[np.float64]

_ABOVE_MM: Final = 1.5
_RESAMPLES, _SEED = 2000, 0
_OUTER: Final = (2.5, 97.5)
MARKER_PARTS: Final = ("all", "middle", "edge", "trial mean", "slow", "fast")
"""Of the error of markers: by region of the picture, and by frequency over the env steps of a trial; slow ones have a
period of four env steps or more."""


class NoTouchRecorded(VitacError):
    """The trials have no record of markers and forces; play them again with this version."""


class TouchGap(StrictModel):
    """Root mean square errors over trials, with intervals by trial."""

    trials: int
    markers_px: dict[str, Measured]
    """Of the mean movement of markers in nine regions of each gel, by `MARKER_PARTS`."""
    force_n: Measured
    """Of the force on the peg."""


def measure_touch_gap(reports: Sequence[RehearsalReport], hidden: HiddenSettings) -> TouchGap:
    """Return the gap of trials to our simulation with these settings, along the motions that the encoders saw.

    Raises:
        NoTouchRecorded: no trial has a record.
    """
    replay = _Replay(hidden)
    squares = [
        replay.squares(report.hole, trial.shape, trial.attempts[-1])
        for report in reports
        for trial in report.trials
        if report.hole is not None and trial.outcome.counts and trial.attempts[-1].regions_px
    ]
    if not squares:
        raise NoTouchRecorded("The trials have no record of markers and forces. Play them again with this version.")
    drawn = np.random.default_rng(_SEED).integers(len(squares), size=(_RESAMPLES, len(squares)))
    values = np.sqrt(np.mean(squares, axis=0))
    low, high = np.percentile(np.sqrt(np.array(squares)[drawn].mean(axis=1)), _OUTER, axis=0)
    rows = [
        Measured(value=v, low=a, high=b) for v, a, b in zip(values.tolist(), low.tolist(), high.tolist(), strict=True)
    ]
    return TouchGap(
        trials=len(squares), markers_px=dict(zip(MARKER_PARTS, rows, strict=False)), force_n=rows[len(MARKER_PARTS)]
    )


class _Replay:
    """Trials in our simulation."""

    def __init__(self, hidden: HiddenSettings) -> None:
        self._hidden = hidden
        gel = twin_gel(hidden.structure)
        self._meshes, self._markers = Meshes(gel=gel, is_arena=True), PrintedMarkers(gel, marker_grid())

    def squares(self, hole: Axes, shape: str, attempt: AttemptRecord) -> FloatArray:
        """Return the mean squares of a trial's errors: of markers by `MARKER_PARTS`, and of the force."""
        poses = [in_world(axes, hole, self._hidden) for axes in attempt.encoders]
        x, y, z, rotation = poses[0]
        held = hold_peg(Mounted(shape=shape), (x, y, z + _ABOVE_MM, rotation), self._hidden, self._meshes)
        free_px, free_n = self._see(held), np.array(held.wrench()[:3])
        regions, forces = [], []
        for pose in poses:
            held.follow((*pose[:2], held.axes[2], pose[3]))
            held.follow(pose)
            flows = [MarkerFlow(*pair) for pair in zip(free_px, self._see(held), strict=True)]
            regions.append([mean_by_region(flow) for flow in flows])
            forces.append(np.array(held.wrench()[:3]) - free_n)
        wrong_px = np.array(attempt.regions_px) - np.array(regions)
        wrong_n = np.array(attempt.wrenches)[:, :3] - np.array(forces)
        return np.array([*_parts(wrong_px), (wrong_n**2).sum(axis=1).mean()])

    def _see(self, held: HeldPeg) -> list[FloatArray]:
        sensors = self._hidden.left, self._hidden.right
        poses: list[SensorPose] = [held.scene.sensor_pose(side) for side in range(len(sensors))]
        return [
            see_through_lens(
                sensor, self._markers.project_px(self._markers.in_camera_m(held.scene.gel_nodes_m(side), pose))
            )
            for side, (sensor, pose) in enumerate(zip(sensors, poses, strict=True))
        ]


def _parts(wrong_px: FloatArray) -> list[float]:
    """Return the mean squares of errors of shape [t, 2, 9, 2] by `MARKER_PARTS`; those by frequency add up to all."""
    squares = (wrong_px**2).sum(axis=3)
    is_middle = np.arange(squares.shape[2]) == MIDDLE_REGION
    count = len(wrong_px)
    power = (np.abs(np.fft.fft(wrong_px, axis=0) / count) ** 2).sum(axis=3).mean(axis=(1, 2))
    frequency = np.abs(np.fft.fftfreq(count))
    is_slow = (frequency > 0.0) & (frequency <= 0.25)
    parts = (
        squares.mean(),
        squares[:, :, is_middle].mean(),
        squares[:, :, ~is_middle].mean(),
        power[0],
        power[is_slow].sum(),
        power[frequency > 0.25].sum(),
    )
    return [float(part) for part in parts]
