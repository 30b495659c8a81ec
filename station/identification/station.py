"""Identifies a station: its settings with intervals, as a file that twins, environments and training take."""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.envs.geometry.pegs import CLEARANCE_MM
from vitac.envs.tasks.quantities import CAMERA_MOUNT_QUANTITIES
from vitac.envs.tasks.registry import task_definitions
from vitac.evaluator.strict_model import StrictModel

from ..description import StagePose, TwinMark
from ..eyes import OpenStation
from ..twin.grasp import GRIP_MM, Axes, Mounted
from ..twin.hidden import HiddenSettings
from ..twin.structure import Branch
from .camera import FittedCamera, fit_camera, stretched_print
from .mechanics import Estimate, fit_mechanics
from .probes import ProbeKind, Probing, play_probes

_QUANTILE: Final = 1.96
_RELAXATIONS_S: Final = np.geomspace(0.2, 6.0, 40)
_ENV_ID: Final = "ViTac/PegInsertion-v1"
_SMALLEST_RATIO: Final = 0.005
_UNSEEN: Final = (
    "a print that is shifted or turned as a whole: it looks like a camera that is",
    "a tilt that plate and peg share: it looks like a grasp beside the peg's middle",
    "the heights of grasp and plate apart: their sum decides where the peg touches",
    "a giving stage or fingers and a stiffening gel apart from each other: all change the forces on the plate, so "
    "modulus and frictions are effective values",
    "light, noise, latency and drift: no move shows them, and `vitac station check` and the tracker allow for them",
)


class Identified(StrictModel):
    """A number of a station with its 95 % interval."""

    value: float
    low: float
    high: float
    seen: bool
    """Whether probing has shown it; else the interval is that of what a station is built to be."""


class IdentifiedStation(StrictModel):
    """What probing has shown of a station; the file that `vitac station identify` writes."""

    station: str
    twin: TwinMark | None
    """Where the station is a twin."""
    estimates: dict[str, Identified]
    misfit: float
    """Root mean square of what our simulation of the probes leaves, over what was expected of noise."""
    unseen: tuple[str, ...]
    """What probing cannot show."""
    settings: HiddenSettings
    """For a twin of the station."""
    draws: dict[str, tuple[float, float]]
    """For environments and tasks under `arena-2`: the intervals of what was seen."""


def identify(station: OpenStation, show: Callable[[str], None] = lambda _: None) -> IdentifiedStation:
    """Play the probes on a station, and return the settings that they show.

    Args:
        station: open and safe.
        show: called with a sentence as each part begins.

    Raises:
        NothingFelt: plate or hole are not where the file says.
        NoPeg: the gripper closes on nothing.
        TooFewMarkers: a gel shows too few.
    """
    probing = play_probes(station, lambda probe: show(f"Probing: {probe}"))
    procedure, description = station.procedure, station.description
    show("Fitting our simulation of the probes; this takes some minutes.")
    return read_probes(
        probing,
        Mounted(shape=procedure.shape),
        _axes(procedure.hole),
        name=description.name,
        twin=description.twin,
        show=show,
    )


def _axes(pose: StagePose) -> Axes:
    return pose.x_mm, pose.y_mm, pose.z_mm, pose.rotation_deg


def read_probes(
    probing: Probing,
    mounted: Mounted,
    hole: Axes,
    *,
    name: str = "station",
    twin: TwinMark | None = None,
    show: Callable[[str], None] = lambda _: None,
) -> IdentifiedStation:
    """Return the settings that probes show.

    Args:
        probing: the record.
        mounted: peg and hole.
        hole: where the station's file has it.
        name: of the station.
        twin: where it is a twin.
        show: called with a sentence after each try of the fit.
    """
    cameras = {"left": fit_camera(probing.rest_px[0]), "right": fit_camera(probing.rest_px[1])}
    branch, viscosity = _fit_viscosity(probing)
    sensors = cameras["left"].sensor, cameras["right"].sensor
    mechanics = fit_mechanics(
        probing,
        sensors,
        mounted,
        hole,
        lambda number, misfit: show(f"Try {number + 1}: the simulation misses the probes by {misfit:.2f} of noise"),
    )
    estimates = {**mechanics.estimates, **viscosity}
    for side, camera in cameras.items():
        estimates |= {f"{side}_{each}": estimate for each, estimate in _camera_estimates(camera).items()}
    printed = stretched_print(float(np.mean([camera.print.stretch for camera in cameras.values()])))
    structure = mechanics.hidden.structure.model_copy(
        update={"viscosity": (branch,) if branch else (), "print": printed}
    )
    hidden = mechanics.hidden.model_copy(update={"left": sensors[0], "right": sensors[1], "structure": structure})
    return IdentifiedStation(
        station=name,
        twin=twin,
        estimates={
            each: Identified(value=value, low=low, high=high, seen=seen)
            for each, (value, low, high, seen) in estimates.items()
        },
        misfit=mechanics.misfit,
        unseen=_UNSEEN,
        settings=hidden,
        draws=_draws(estimates),
    )


def _camera_estimates(camera: FittedCamera) -> dict[str, Estimate]:
    return {name: _around(value, camera.deviations[name]) for name, value in camera.values.items()}


def _around(value: float, deviation: float) -> Estimate:
    return Estimate(value, value - _QUANTILE * deviation, value + _QUANTILE * deviation, True)


class _Relaxation(NamedTuple):
    left: float
    time_s: float
    ratio: float
    deviation: float


def _fit_viscosity(probing: Probing) -> tuple[Branch | None, dict[str, Estimate]]:
    """Return the branch with which a held press relaxes, where it does."""
    held = probing.of(ProbeKind.HOLD)
    times_s = np.array([sample.after_s for sample in held])
    forces_n = np.array([float(np.linalg.norm(sample.wrench[:3])) for sample in held])
    best = min((_relax(times_s, forces_n, float(time_s)) for time_s in _RELAXATIONS_S), key=lambda each: each.left)
    is_seen = best.ratio > max(_SMALLEST_RATIO, _QUANTILE * best.deviation)
    ratio = max(best.ratio, 0.0) if is_seen else 0.0
    estimates = {
        "viscous_ratio": _around(ratio, best.deviation),
        "relaxation_s": Estimate(best.time_s, float(_RELAXATIONS_S[0]), float(_RELAXATIONS_S[-1]), False),
    }
    return (Branch(modulus_ratio=ratio, relaxation_time_s=best.time_s) if is_seen else None), estimates


def _relax(times_s: NDArray[np.float64], forces_n: NDArray[np.float64], time_s: float) -> _Relaxation:
    """Return the fit of a + b exp(-t / tau) to the forces."""
    columns = np.column_stack([np.ones(len(times_s)), np.exp(-times_s / time_s)])
    (rest_n, more_n), *_ = np.linalg.lstsq(columns, forces_n, rcond=None)
    left = forces_n - columns @ (rest_n, more_n)
    variance = float(left @ left) / (len(times_s) - 3)
    deviation_n = np.sqrt(variance * np.linalg.inv(columns.T @ columns)[1, 1])
    return _Relaxation(float(left @ left), time_s, more_n / rest_n, deviation_n / rest_n)


def _draws(estimates: dict[str, Estimate]) -> dict[str, tuple[float, float]]:
    """Return the intervals of what was seen as quantities of environments, within what these can have."""
    names = {
        "gel_modulus_kpa": ("youngs_modulus_pa", 1e-3, 0.0),
        "gel_poisson_ratio": ("poisson_ratio", 1.0, 0.0),
        "gel_viscous_ratio": ("viscous_ratio", 1.0, 0.0),
        "indentation_mm": ("indentation_mm", 1.0, 0.0),
        "gel_friction": ("gel_friction", 1.0, 0.0),
        "part_friction": ("plate_friction", 1.0, 0.0),
        "gripper_x_mm": ("grasp_x_mm", 1.0, 0.0),
        "gripper_z_mm": ("grasp_z_mm", 1.0, GRIP_MM),
        "clearance_mm": ("tolerance_mm", 1.0, CLEARANCE_MM),
        "peg_tilt_deg": ("peg_tilt_deg", 1.0, 0.0),
        "hole_tilt_x_deg": ("plate_tilt_x_deg", 1.0, 0.0),
        "hole_tilt_y_deg": ("plate_tilt_y_deg", 1.0, 0.0),
        **{quantity.name: (quantity.name, 1.0, 0.0) for quantity in CAMERA_MOUNT_QUANTITIES},
    }
    ranges = {quantity.name: quantity.range for quantity in task_definitions()[_ENV_ID].quantities}
    draws = {}
    for quantity, (name, factor, offset) in names.items():
        estimate = estimates[name]
        if estimate.is_seen:
            ends = factor * np.array((estimate.low, estimate.high)) + offset
            low, high = np.clip(ends, *ranges[quantity]).tolist()
            draws[quantity] = (low, high)
    return draws
