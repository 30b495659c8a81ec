"""Frictions, gel, grasp and places of a station: those with which our simulation of the probes shows what was recorded.

Gauss and Newton's method, damped and with Huber's weights, from what a station is built to be, whose spread counts as
one more measurement of each number: what no probe shows keeps its spread.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.scene.gripper import SensorPose
from vitac.errors import VitacError

from ..twin.bench import GRIP_FORCE
from ..twin.gel_view import PrintedMarkers, marker_grid
from ..twin.grasp import Axes, HeldPeg, Mounted, grip_harder, hold_peg, in_world
from ..twin.hidden import HiddenSensor, HiddenSettings
from ..twin.structure import HiddenStructure, twin_gel
from .camera import undo_lens
from .probes import LIGHT_FORCE, ProbeKind, Probing, Sample

FloatArray = NDArray[np.float64]

_SEEN_SPREAD: Final = 0.5
"""A number is seen whose spread the probes have more than halved."""
_ITERATIONS: Final = 4
_DAMPINGS: Final = (0.0, 3.0, 30.0, 300.0)
"""Of the moves that are tried one after the other (Levenberg and Marquardt)."""
_ROBUST: Final = 3.0
"""A difference of this many deviations of noise or more counts in proportion to its size alone: a structure that our
simulation lacks is not to outweigh the rest."""
_STEP: Final = 0.15
"""Of a number in its spread, for the slopes."""
_FARTHEST: Final = 3.0
_FORCE_N, _FORCE_PART, _TORQUE_NM = 0.15, 0.03, 0.01
_FLOW_PX: Final = 0.15
_ARM_PX: Final = 100.0
_MIDDLE_PX: Final = np.array((160.0, 120.0))


class _Number(NamedTuple):
    """One number: what it is built to be, how much it spreads, and whether by a factor."""

    name: str
    nominal: float
    spread: float
    by_factor: bool = False

    def at(self, z: float) -> float:
        """Return its value at a number of spreads from the nominal one."""
        return float(self.nominal * np.exp(self.spread * z)) if self.by_factor else self.nominal + self.spread * z


_NUMBERS: Final = (
    _Number("youngs_modulus_pa", 3e5, 0.35, by_factor=True),
    _Number("poisson_ratio", 0.472, 0.012),
    _Number("indentation_mm", 0.875, 0.15),
    _Number("gel_friction", 1.0, 0.35, by_factor=True),
    _Number("plate_friction", 0.3, 0.5, by_factor=True),
    _Number("grasp_x_mm", 0.0, 0.6),
    _Number("grasp_z_mm", 0.0, 0.3),
    _Number("plate_mm", 0.0, 0.25),
    _Number("origin_x_mm", 0.0, 0.25),
    _Number("origin_y_mm", 0.0, 0.25),
    _Number("origin_deg", 0.0, 0.4),
)


class Estimate(NamedTuple):
    """A number with its 95 % interval, and whether the probes have shown it."""

    value: float
    low: float
    high: float
    is_seen: bool


class FittedMechanics(NamedTuple):
    """What the simulation needs to show what was recorded.

    Attributes:
        hidden: as settings of a twin.
        estimates: by name.
        misfit: root mean square of what is left, over what was expected of noise.
    """

    hidden: HiddenSettings
    estimates: dict[str, Estimate]
    misfit: float


def _cost(left: FloatArray) -> float:
    """Return the pseudo-Huber cost of differences."""
    return float((np.sqrt(1.0 + (left / _ROBUST) ** 2) - 1.0).sum())


class _Replay:
    """The probes in our simulation."""

    def __init__(
        self, probing: Probing, sensors: tuple[HiddenSensor, HiddenSensor], mounted: Mounted, hole: Axes,
        structure: HiddenStructure,
    ) -> None:  # fmt: skip
        self._mounted, self._hole, self._structure = mounted, hole, structure
        gel = twin_gel(HiddenStructure())
        self._meshes, self._markers = Meshes(gel=gel, is_arena=True), PrintedMarkers(gel, marker_grid())
        self._samples = probing.of(*(probe for probe in ProbeKind if probe is not ProbeKind.HOLD))
        self._rest_px = [self._markers.project_px(self._in_camera(gel.rest_position_m))] * 2
        self.observed = np.concatenate([self._observe(sample, sensors) for sample in self._samples])
        self.noise = np.concatenate([_noise_of(sample) for sample in self._samples])

    def _in_camera(self, rest_m: FloatArray) -> FloatArray:
        return self._markers.in_camera_m(rest_m, SensorPose(rotation=np.eye(3), centre_m=np.zeros(3)))

    def _observe(self, sample: Sample, sensors: tuple[HiddenSensor, HiddenSensor]) -> FloatArray:
        flows = []
        for sensor, flow in zip(sensors, sample.flows, strict=True):
            reference, current = undo_lens(sensor, flow.reference), undo_lens(sensor, flow.current)
            flows.append(_affine(reference, current - reference))
        return np.concatenate([sample.wrench[[0, 1, 2, 5]], *flows])

    def hidden(self, z: FloatArray) -> HiddenSettings:
        """Return the twin at numbers of spreads from what a station is built to be."""
        values: dict[str, Any] = {
            number.name: number.at(each) for number, each in zip(_NUMBERS, z.tolist(), strict=True)
        }
        origin = (values.pop("origin_x_mm"), values.pop("origin_y_mm"), values.pop("origin_deg"))
        return HiddenSettings(**values, origin=origin, structure=self._structure)

    def predict(self, z: FloatArray) -> FloatArray:
        """Return what the simulation shows in place of `observed`."""
        hidden = self.hidden(z)
        held: HeldPeg | None = None
        shown, zero = [], np.zeros(6)
        for number, sample in enumerate(self._samples):
            if sample.probe in (ProbeKind.GRASP, ProbeKind.LIGHT_GRASP):
                factor = LIGHT_FORCE / GRIP_FORCE if sample.probe is ProbeKind.LIGHT_GRASP else 1.0
                first = next(each for each in self._samples[number:] if each.probe is ProbeKind.AIR)
                held = hold_peg(self._mounted, self._at(first, hidden), grip_harder(hidden, factor), self._meshes)
            if held is None:
                raise VitacError("The first probe has to be a grasp; play all probes.")
            axes = self._at(sample, hidden)
            if sample.probe is ProbeKind.AIR:
                held.follow((*held.axes[:2], max(axes[2], held.axes[2]), held.axes[3]))
            if sample.probe not in (ProbeKind.GRASP, ProbeKind.LIGHT_GRASP):
                held.follow(axes)
            wrench = np.array(held.wrench())
            if sample.probe is ProbeKind.AIR:
                zero = wrench
            shown.append(np.concatenate([(wrench - zero)[[0, 1, 2, 5]], *self._flows(held)]))
        return np.concatenate(shown)

    def _at(self, sample: Sample, hidden: HiddenSettings) -> Axes:
        return in_world(sample.axes, self._hole, hidden)

    def _flows(self, held: HeldPeg) -> list[FloatArray]:
        flows = []
        for side, rest_px in enumerate(self._rest_px):
            gel_m = self._markers.in_camera_m(held.scene.gel_nodes_m(side), held.scene.sensor_pose(side))
            flows.append(_affine(rest_px, self._markers.project_px(gel_m) - rest_px))
        return flows


def _affine(places_px: FloatArray, movement_px: FloatArray) -> FloatArray:
    """Return the affine motion of markers: of the middle, and by how much more 100 pixels away along u and v."""
    arms = np.column_stack([np.ones(len(places_px)), (places_px - _MIDDLE_PX) / _ARM_PX])
    return np.asarray(np.linalg.lstsq(arms, movement_px, rcond=None)[0].ravel())


def _noise_of(sample: Sample) -> FloatArray:
    force_n, torque_nm = np.abs(sample.wrench[:3]), abs(sample.wrench[5])
    forces = _FORCE_N + _FORCE_PART * np.full(3, force_n.max())
    return np.concatenate([forces, [_TORQUE_NM + _FORCE_PART * torque_nm], np.full(12, _FLOW_PX)])


def fit_mechanics(
    probing: Probing,
    sensors: tuple[HiddenSensor, HiddenSensor],
    mounted: Mounted,
    hole: Axes,
    structure: HiddenStructure,
    show: Callable[[int, float], None] = lambda _iteration, _misfit: None,
) -> FittedMechanics:
    """Return what the simulation needs to show what was recorded.

    Args:
        probing: the record.
        sensors: cameras as fitted.
        mounted: peg and hole.
        hole: where the station's file has it.
        structure: what is known already: viscosity and the plate's tilt.
        show: called with the number and misfit of each iteration.
    """
    replay = _Replay(probing, sensors, mounted, hole, structure)

    def left_over(z: FloatArray) -> FloatArray:
        return np.concatenate([(replay.observed - replay.predict(z)) / replay.noise, -z])

    z = np.zeros(len(_NUMBERS))
    left = left_over(z)
    for iteration in range(_ITERATIONS):
        slopes = np.array([(left_over(z + move) - left) / _STEP for move in _STEP * np.eye(len(z))]).T
        weights = (1.0 + (left / _ROBUST) ** 2) ** -0.25
        weighted = slopes * weights[:, None]
        curvature, fall = weighted.T @ weighted, -weighted.T @ (left * weights)
        for damping in _DAMPINGS:
            move = np.linalg.solve(curvature + damping * np.eye(len(z)), fall)
            nearer = np.clip(z + move, -_FARTHEST, _FARTHEST)
            then = left_over(nearer)
            if _cost(then) < _cost(left):
                z, left = nearer, then
                break
        misfit = float(np.sqrt(np.mean(left[: len(replay.observed)] ** 2)))
        show(iteration, misfit)
    deviations = max(1.0, misfit) * np.sqrt(np.diag(np.linalg.inv(curvature)))
    estimates = {
        number.name: Estimate(
            number.at(each),
            number.at(each - 1.96 * deviation),
            number.at(each + 1.96 * deviation),
            bool(deviation < _SEEN_SPREAD),
        )
        for number, each, deviation in zip(_NUMBERS, z, deviations, strict=True)
    }
    return FittedMechanics(replay.hidden(z), estimates, misfit)
