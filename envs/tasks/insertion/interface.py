"""Actions, observables and measures that all insertion tasks have; light to import."""

from typing import TYPE_CHECKING, Any

from ...observable import Observable
from ...scene.observables import marker_flow
from ..definition import ActionComponent, Measure
from ..quantities import TOUCH_QUANTITIES, Quantity, setting

if TYPE_CHECKING:
    from .scene import InsertionScene

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

INSERTION_QUANTITIES = (
    *TOUCH_QUANTITIES,
    Quantity(
        name="gripper_x_mm",
        unit="mm",
        meaning="Grasp beside the middle of the peg",
        range=(-7.0, 7.0),
        nominal=0.0,
        two_sided=True,
        apply=setting("gripper_x_mm"),
    ),
    Quantity(
        name="gripper_z_mm",
        unit="mm",
        meaning="Grasp above the peg's upper end",
        range=(-17.0, -6.0),
        nominal=-8.0,
        apply=setting("gripper_z_mm"),
    ),
    Quantity(
        name="clearance_mm",
        unit="mm",
        meaning="Clearance of the hole per side",
        range=(0.1, 3.0),
        nominal=1.5,
        apply=setting("clearance_mm"),
    ),
)
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


def gt_offset(unit: str, meaning: str) -> "Observable[InsertionScene[Any, Any]]":
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


def relative_motion(since: str) -> "Observable[InsertionScene[Any, Any]]":
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
