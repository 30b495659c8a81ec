"""Actions, observables, measures and the perspective that all insertion tasks have; light to import."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...geometry.pegs import CLEARANCE_MM
from ...observable import Observable
from ...scene.observables import marker_flow
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ..definition import ActionComponent, Measure
from ..quantities import TOUCH_QUANTITIES, Quantity, symmetric

_LIMIT_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class PegOffset:
    """Pose of the peg (and the gripper) relative to its hole.

    Attributes:
        x_mm: world x [mm].
        y_mm: world y [mm].
        theta_deg: about the vertical [deg].
    """

    x_mm: float
    y_mm: float
    theta_deg: float

    def magnitude(self) -> float:
        """Return the euclidean norm of the numbers in mm and degrees, the error e of the reward."""
        return norm(self.as_tuple())

    def as_array(self) -> NDArray[np.float64]:
        """Return x [mm], y [mm], theta [deg] and what a task adds to them, shape [3] or more."""
        return np.array(self.as_tuple())

    def as_tuple(self) -> tuple[float, ...]:
        """Return the same numbers; `dataclasses.astuple` copies each deeply, which takes thirty times as long."""
        return tuple(vars(self).values())


def norm(values: Iterable[float]) -> float:
    """Return the euclidean norm."""
    return sqrt(sum(value * value for value in values))


def is_beyond(value: float, largest: float) -> bool:
    """Return whether a commanded value is beyond its limit either way, by more than rounding."""
    return abs(value) > largest + _LIMIT_TOLERANCE


class HasOffset(Protocol):
    """A scene with a peg that is commanded relative to its hole."""

    @property
    def offset(self) -> PegOffset:
        """Commanded offset."""

    def relative_motion_mm_deg(self) -> FloatArray:
        """Return the commanded motion since the start [mm, mm, deg, mm], shape (4,)."""


MARKER_FLOW = marker_flow(
    "With the peg unturned u+ is up for both sensors; v+ is -x for the left and +x for the right one."
)

PEG_HEIGHT = Measure(
    name="peg_relative_z_mm",
    label="peg",
    meaning="height of the peg's bottom corners above the rim",
    unit="mm",
    needs=("peg_relative_z_mm",),
    read=lambda info: tuple(info["peg_relative_z_mm"]),
)
"""Height of each bottom corner of the peg above the rim, measured [mm]."""

LARGEST_TILT_DEG = 3.0

_GRASP_AND_HOLE = GRIPPER_X, GRIPPER_Z, CLEARANCE, *TILTS = (
    symmetric(name="gripper_x_mm", unit="mm", meaning="Grasp beside the middle of the peg", largest=7.0),
    Quantity(
        name="gripper_z_mm",
        unit="mm",
        meaning="Grasp above the peg's upper end",
        range=(-17.0, -6.0),
        nominal=-8.0,
    ),
    Quantity(
        name="clearance_mm",
        unit="mm",
        meaning="Clearance of the hole per side",
        range=(0.1, 3.0),
        nominal=CLEARANCE_MM,
    ),
    symmetric(
        name="peg_tilt_deg",
        unit="degree",
        meaning="Tilt of the peg in the grasp, about the axis along which the gels close",
        largest=LARGEST_TILT_DEG,
    ),
    symmetric(
        name="hole_tilt_x_deg",
        unit="degree",
        meaning="Tilt of the part with the hole about the world's x axis",
        largest=LARGEST_TILT_DEG,
    ),
    symmetric(
        name="hole_tilt_y_deg",
        unit="degree",
        meaning="Tilt of the part with the hole about the world's y axis",
        largest=LARGEST_TILT_DEG,
    ),
)
INSERTION_QUANTITIES = (*TOUCH_QUANTITIES, *_GRASP_AND_HOLE)
"""Quantities of every task that inserts a peg."""


def horizontal_actions(*, xy_mm: float, theta_deg: float) -> tuple[ActionComponent, ActionComponent, ActionComponent]:
    """Return x, y and theta of the gripper with their motions at 1."""
    return (
        ActionComponent(
            name="x",
            scale=xy_mm,
            unit="mm",
            meaning=(
                "Gripper motion along its own x axis (across the grasping direction); scaled, clipped, then turned by "
                "the present angle."
            ),
        ),
        ActionComponent(
            name="y",
            scale=xy_mm,
            unit="mm",
            meaning="Gripper motion along its own y axis (the grasping direction); as x.",
        ),
        ActionComponent(
            name="theta",
            scale=theta_deg,
            unit="degree",
            meaning="Rotation about the vertical, counter-clockwise from above.",
        ),
    )


def gt_offset(unit: str, meaning: str) -> Observable[HasOffset]:
    """Return the observable of the commanded offset.

    Args:
        unit: of each number, separated by commas.
        meaning: what is more to say of it than that it is the commanded offset from the hole.
    """
    return Observable(
        name="gt_offset",
        shape=(unit.count(",") + 1,),
        unit=unit,
        meaning=f"Commanded offset from the hole {meaning}",
        read=lambda scene, _: scene.offset.as_array(),
        privileged=True,
    )


def relative_motion(since: str) -> Observable[HasOffset]:
    """Return the observable of the commanded motion.

    Args:
        since: where it starts, and what is not counted.
    """
    return Observable(
        name="relative_motion",
        shape=(4,),
        unit="mm, mm, degree, mm",
        meaning=f"Commanded gripper motion [dx, dy, dtheta, dz] since {since}",
        read=lambda scene, _: scene.relative_motion_mm_deg(),
    )


def insertion_perspective(*, fixed_name: str, section: SectionView, title: str, depth_mm: float) -> Perspective:
    """Return the perspective of an insertion task.

    Args:
        fixed_name: of the part with the hole.
        section: the view from above; see `section_from_above`.
        title: of the peg's height in the time line.
        depth_mm: how deep the peg's lower end must be [mm].
    """
    return Perspective(
        held_name="peg",
        fixed_name=f"{fixed_name}, cut open",
        azimuth_deg=-38.0,
        elevation_deg=24.0,
        gel_labels=(Beside.ABOVE, Beside.LEFT),
        cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
        section=section,
        progress=ProgressPlot(title=title, heights_mm=_heights_mm, goal_mm=-depth_mm, goal_is_below=True),
        position=_position,
        arrival="went in",
    )


def section_from_above(
    title: str, *, peg_z_m: float, fixed_z_m: float, limits_mm: tuple[tuple[float, float], tuple[float, float]]
) -> SectionView:
    """Return the view from above on the peg and the fixed part, each cut at a height of its own [m]."""
    return SectionView(
        title=title,
        held_cut=_level(peg_z_m),
        fixed_cut=_level(fixed_z_m),
        axes=((0, "x"), (1, "y")),
        limits_mm=limits_mm,
    )


def _level(z_m: float) -> Plane:
    return Plane(normal=(0.0, 0.0, 1.0), offset_m=z_m)


def _heights_mm(info: InfoView) -> FloatArray:
    return np.asarray(info["peg_relative_z_mm"])


def _position(info: InfoView) -> str:
    x, y, theta, *z = info["gt_offset_mm_deg"]
    height = "".join(f", z {signed(value)} mm" for value in z)
    return f"offset x {signed(x)} mm, y {signed(y)} mm, θ {signed(theta)}°{height}"
