"""Frictions, gel, grasp and places of a station: those with which our simulation of the probes shows what was recorded.

Gauss and Newton's method, damped and with Huber's weights, from what a station is built to be, whose spread counts as
one more measurement of each number: what no probe shows keeps its spread.
"""

from collections import Counter
from collections.abc import Callable, Collection
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.scene.gripper import SensorPose
from vitac.errors import VitacError

from ..twin.bench import GRIP_FORCE, Backlash
from ..twin.gel_view import PrintedMarkers, marker_grid
from ..twin.grasp import Axes, HeldPeg, Mounted, grip_harder, hold_peg, in_world
from ..twin.hidden import HiddenSensor, HiddenSettings
from ..twin.structure import HiddenStructure, Tilt, twin_gel
from .camera import undo_lens
from .probes import LIGHT_FORCE, ProbeKind, Probing, Sample

FloatArray = NDArray[np.float64]

_SEEN_SPREAD: Final = 0.5
"""A number is seen whose spread the probes have more than halved."""
_TRIES: Final = 40
"""Simulations of all probes besides those for the slopes."""
_DAMPING: Final = 10.0
"""Of the first try after slopes by differences (Levenberg and Marquardt): numbers that little shows hardly move."""
_FITTED: Final = 0.2
"""Misfit from which on intervals are wider than noise makes them: what our simulation lacks shifts the numbers."""
_STIFF: Final = 1e3
"""Damping from which on a try that gains nothing says that nothing is to be gained; below, that it went too far."""
_LITTLE, _WEAK = 0.1, 2
"""Part of the cost that a try is worth at least, and how many in a row that gain less end a search."""
_LOOSE_MM: Final = 2.0
"""Strip of a gel that has come off its backing, where a grasp in free air looks so."""
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
_FINE_MM, _WALL_MM, _AIR_MM = 0.05, 0.3, 1.0
"""Longest way in one IPC step: friction over longer ones is another."""
_WAYS_MM: Final = dict.fromkeys((ProbeKind.WALL, ProbeKind.TURN), _WALL_MM) | dict.fromkeys(
    (ProbeKind.AIR, ProbeKind.MIDDLE), _AIR_MM
)
_GRASPS: Final = (ProbeKind.GRASP, ProbeKind.LIGHT_GRASP)
_ALL: Final = tuple(probe for probe in ProbeKind if probe is not ProbeKind.HOLD)
_CLEAR_MM: Final = 3.0
"""Above where a station feels nothing, a peg that is tilted otherwise in a try is clear of the plate, too."""
_LIFT_MM: Final = 1.0
"""By which the stage at least is higher on its way over the plate."""


class _Number(NamedTuple):
    """One number: what it is built to be, how much it spreads, whether by a factor, and as far as it can go."""

    name: str
    nominal: float
    spread: float
    by_factor: bool = False
    largest: float = np.inf

    def at(self, z: float) -> float:
        """Return its value at a number of spreads from the nominal one."""
        value = self.nominal * np.exp(self.spread * z) if self.by_factor else self.nominal + self.spread * z
        return min(float(value), self.largest)


_NUMBERS: Final = (
    _Number("youngs_modulus_pa", 3e5, 0.35, by_factor=True),
    _Number("poisson_ratio", 0.472, 0.012, largest=0.495),
    _Number("indentation_mm", 0.875, 0.15),
    _Number("gel_friction", 1.0, 0.35, by_factor=True),
    _Number("plate_friction", 0.3, 0.5, by_factor=True),
    _Number("grasp_x_mm", 0.0, 0.6),
    _Number("grasp_z_mm", 0.0, 0.2),
    _Number("plate_mm", 0.0, 0.15),
    _Number("origin_x_mm", 0.0, 0.25),
    _Number("origin_y_mm", 0.0, 0.25),
    _Number("origin_deg", 0.0, 0.4),
    _Number("plate_tilt_x_deg", 0.0, 0.8),
    _Number("plate_tilt_y_deg", 0.0, 0.8),
    _Number("peg_tilt_deg", 0.0, 0.8),
    _Number("tolerance_mm", 0.0, 0.06),
    _Number("backlash_mm", 0.015, 0.7, by_factor=True),
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
        unbonded_mm: float, probes: Collection[ProbeKind],
    ) -> None:  # fmt: skip
        self._mounted, self._hole, self._unbonded_mm = mounted, hole, unbonded_mm
        gel = twin_gel(HiddenStructure(unbonded_mm=unbonded_mm))
        self._meshes, self._markers = Meshes(gel=gel, is_arena=True), PrintedMarkers(gel, marker_grid())
        self._samples = probing.of(*probes)
        self._rest_px = [self._markers.project_px(self._in_camera(gel.rest_position_m))] * 2
        self.observed = np.concatenate([self._observe(sample, sensors) for sample in self._samples])
        self.noise = np.concatenate([_noise_of(sample) for sample in self._samples])
        alike = Counter(sample.probe for sample in self._samples)
        parts = [1.0 / alike[sample.probe] for sample in self._samples]
        self.parts = np.repeat(parts, len(self.noise) // len(parts))

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
        plate_deg = (values.pop("plate_tilt_x_deg"), values.pop("plate_tilt_y_deg"))
        structure = HiddenStructure(
            tilt=Tilt(peg_deg=values.pop("peg_tilt_deg"), plate_deg=plate_deg),
            tolerance_mm=values.pop("tolerance_mm"),
            unbonded_mm=self._unbonded_mm,
        )
        return HiddenSettings(**values, origin=origin, structure=structure)

    def predict(self, z: FloatArray) -> FloatArray:
        """Return what the simulation shows in place of `observed`."""
        hidden = self.hidden(z)
        stage = [Backlash(play_mm=hidden.backlash_mm) for _ in range(3)]
        held: HeldPeg | None = None
        shown, zero = [], np.zeros(6)
        for number, sample in enumerate(self._samples):
            if sample.probe in _GRASPS:
                factor = LIGHT_FORCE / GRIP_FORCE if sample.probe is ProbeKind.LIGHT_GRASP else 1.0
                first = next((each for each in self._samples[number:] if each.probe is ProbeKind.AIR), sample)
                x_mm, y_mm, z_mm, rotation_deg = in_world(first.axes, self._hole, hidden)
                at = x_mm, y_mm, z_mm + _CLEAR_MM, rotation_deg
                held = hold_peg(self._mounted, at, grip_harder(hidden, factor), self._meshes)
            if held is None:
                raise VitacError("The first probe has to be a grasp; play all probes.")
            *linear, rotation_deg = sample.axes
            if sample.probe is ProbeKind.AIR:
                stage[2].follow(linear[2] + _LIFT_MM)  # from above
            x_mm, y_mm, z_mm = (axis.follow(each) for axis, each in zip(stage, linear, strict=True))
            if sample.probe not in _GRASPS:
                axes = in_world((x_mm, y_mm, z_mm, rotation_deg), self._hole, hidden)
                if sample.probe is ProbeKind.AIR:
                    highest_mm = max(axes[2] + _LIFT_MM, held.axes[2])
                    held.follow((*held.axes[:2], highest_mm, held.axes[3]), _AIR_MM)
                    held.follow((*axes[:2], highest_mm, axes[3]), _AIR_MM)
                elif self._samples[number - 1].probe is ProbeKind.AIR:
                    held.follow((*axes[:2], axes[2] + _WALL_MM, axes[3]), _WALL_MM)
                held.follow(axes, _WAYS_MM.get(sample.probe, _FINE_MM))
            wrench = np.array(held.wrench())
            if sample.probe is ProbeKind.AIR:
                zero = wrench
            shown.append(np.concatenate([(wrench - zero)[[0, 1, 2, 5]], *self._flows(held)]))
        return np.concatenate(shown)

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


class _Fit(NamedTuple):
    """The numbers in spreads from what a station is built to be, what they leave, and its slopes."""

    z: FloatArray
    left: FloatArray
    slopes: FloatArray

    @property
    def cost(self) -> float:
        return _cost(self.left)

    @property
    def misfit(self) -> float:
        """Root mean square of what is left of the probes, over what was expected of noise."""
        return float(np.sqrt(np.mean(self.left[: -len(self.z)] ** 2)))

    def normal_equations(self, parts: FloatArray | float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return the curvature of the cost, shape [n, n], and its fall, shape [n].

        Args:
            parts: as which each difference counts, shape [m].
        """
        weights = (1.0 + (self.left / _ROBUST) ** 2) ** -0.5 * parts
        weighted = self.slopes.T * weights
        return weighted @ self.slopes, -weighted @ self.left


def _left_over(replay: _Replay, z: FloatArray) -> FloatArray:
    return np.concatenate([(replay.observed - replay.predict(z)) / replay.noise, -z])


def _evaluate_fit(replay: _Replay, z: FloatArray) -> _Fit:
    """Return the fit at some numbers, with slopes by differences."""
    left = _left_over(replay, z)
    slopes = [(_left_over(replay, z + move) - left) / _STEP for move in _STEP * np.eye(len(z))]
    return _Fit(z, left, np.array(slopes).T)


def _improve(replay: _Replay, z: FloatArray, show: Callable[[int, float], None] = lambda *_: None) -> _Fit:
    """Return the best fit in reach of some numbers, with slopes by differences.

    Between these the slopes are corrected by what each try has shown (Broyden).
    """
    fit = _evaluate_fit(replay, z)
    damping, weak, is_exact = _DAMPING, 0, True
    for number in range(_TRIES):
        curvature, fall = fit.normal_equations()
        move = np.linalg.solve(curvature + damping * np.eye(len(fall)), fall)
        nearer = np.clip(fit.z + move, -_FARTHEST, _FARTHEST)
        left, way = _left_over(replay, nearer), nearer - fit.z
        slopes = fit.slopes + np.outer(left - fit.left - fit.slopes @ way, way) / (way @ way)
        gain = 1.0 - _cost(left) / fit.cost
        weak = 0 if gain > _LITTLE else weak + (gain > 0.0 or damping >= _STIFF)
        damping *= 0.2 if gain > 0.0 else 10.0
        fit = _Fit(nearer, left, slopes) if gain > 0.0 else fit._replace(slopes=slopes)
        show(number, fit.misfit)
        is_exact = is_exact and gain <= _LITTLE
        if weak == _WEAK:
            if is_exact:
                break
            fit, damping, weak, is_exact = _evaluate_fit(replay, fit.z), _DAMPING, 0, True
    return fit if is_exact else _evaluate_fit(replay, fit.z)


def fit_mechanics(
    probing: Probing,
    sensors: tuple[HiddenSensor, HiddenSensor],
    mounted: Mounted,
    hole: Axes,
    show: Callable[[int, float], None] = lambda _try, _misfit: None,
) -> FittedMechanics:
    """Return what the simulation needs to show what was recorded.

    Args:
        probing: the record.
        sensors: cameras as fitted.
        mounted: peg and hole.
        hole: where the station's file has it.
        show: called with the number and misfit of each try.
    """
    gels_mm = (0.0, _LOOSE_MM)
    of_grasps, of_all = (
        [_Replay(probing, sensors, mounted, hole, gel_mm, probes) for gel_mm in gels_mm] for probes in (_GRASPS, _ALL)
    )
    grasps = [_improve(replay, np.zeros(len(_NUMBERS))) for replay in of_grasps]
    nearest = min(range(len(gels_mm)), key=lambda number: grasps[number].cost)
    replay = of_all[nearest]
    fit = _improve(replay, grasps[nearest].z, show)
    # The samples of a probe share most of their errors, so that all of them count as one.
    curvature, _ = fit.normal_equations(np.concatenate([replay.parts, np.ones(len(_NUMBERS))]))
    deviations = max(1.0, fit.misfit / _FITTED) * np.sqrt(np.diag(np.linalg.inv(curvature)))
    estimates = {
        number.name: Estimate(
            number.at(each),
            number.at(each - 1.96 * deviation),
            number.at(each + 1.96 * deviation),
            bool(deviation < _SEEN_SPREAD),
        )
        for number, each, deviation in zip(_NUMBERS, fit.z, deviations, strict=True)
    }
    return FittedMechanics(replay.hidden(fit.z), estimates, fit.misfit)
