"""The exploring task as others need to know it: actions, observables, measures, how it is drawn; light to import."""

from enum import StrEnum
from typing import Protocol

import numpy as np

from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, marker_flow, played_shape
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ...tactile.gel import ARENA_SENSING_NODES
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, Better, Measure, TaskDefinition
from ..quantities import TOUCH_QUANTITIES


class EndShape(StrEnum):
    """What the block's end looks like from below."""

    SQUARE = "square"
    BAR = "bar"
    BEAM = "beam"
    """A bar across the bar."""
    CROSS = "cross"
    FRAME = "frame"
    """A square with a hole in its middle."""
    CORNER = "corner"
    """Two arms, as an L."""


REACH_MM = 8.0
"""Motion of the gripper in an env step, at most, along each axis."""
LARGEST_XY_MM = 16.0
"""How far the gripper may go from the start along each axis."""


class Explores(Protocol):
    """A scene in which a block is brought down on a pin."""

    def position_mm(self) -> FloatArray:
        """Return where the block is over the pin, x and y [mm], shape [2]."""

    def end_pose_mm_deg(self) -> FloatArray:
        """Return where the end is on the block: x, y and angle [mm, mm, deg], shape [3]."""


_POSITION: Observable[Explores] = Observable(
    name="relative_motion",
    shape=(2,),
    unit="mm",
    meaning="Commanded motion of the gripper since the first touch, [x, y]; then the block is over the pin.",
    read=lambda scene, _: scene.position_mm(),
)
_END_POSE: Observable[Explores] = Observable(
    name="gt_end_pose",
    shape=(3,),
    unit="mm, mm, degree",
    meaning="Where the end is on the block: [x, y, angle about the vertical].",
    read=lambda scene, _: scene.end_pose_mm_deg(),
    privileged=True,
)
BRIER = Measure(
    name="brier_score",
    label="Brier score",
    meaning="Brier score of the confidences",
    unit="1",
    needs=("brier_score",),
    read=lambda info: (float(info["brier_score"]),),
    better=Better.LOW,
)
"""Squared distance of the confidences from the truth, summed over the shapes: from 0, certain and right, to 2.

G. W. Brier, Verification of forecasts expressed in terms of probability, Monthly Weather Review 78 (1950), eq. 2.
"""


def _move(axis: str) -> ActionComponent:
    return ActionComponent(name=axis, scale=REACH_MM, unit="mm", meaning=f"Gripper motion along {axis}.")


def _confidence(shape: EndShape) -> ActionComponent:
    return ActionComponent(
        name=shape,
        scale=1.0,
        unit="1",
        meaning=f"Weight of the answer {shape}: none at -1, most at 1; a confidence is a weight's part of all six.",
    )


TASK = TaskDefinition(
    env_id="ViTac/Explore-v1",
    environment="vitac.envs.tasks.explore.env:ExploreEnv",
    actions=(_move("x"), _move("y"), *(_confidence(shape) for shape in EndShape)),
    observables=(
        _END_POSE,
        _POSITION,
        marker_flow("u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
        played_shape(", ".join(EndShape)),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(SURFACE_DIFF, BRIER),
    start_labels=("x {} mm", "y {} mm", "turned {}°"),
    perspective="vitac.envs.tasks.explore.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.explore.env:touch_around",
    quantities=TOUCH_QUANTITIES,
)


def _place(info: InfoView) -> str:
    x_mm, y_mm = info["relative_motion_mm"]
    return f"{signed(x_mm)}, {signed(y_mm)} mm from the pin"


PERSPECTIVE = Perspective(
    held_name="block",
    fixed_name="pin",
    azimuth_deg=-38.0,
    elevation_deg=-18.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.1),
    section=SectionView(
        title="end of the block and pin from above",
        held_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=25e-3),
        fixed_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=19e-3),
        axes=((0, "x"), (1, "y")),
        limits_mm=((-30.0, 30.0), (-22.5, 22.5)),
    ),
    progress=ProgressPlot(
        title="Brier score of the answer",
        heights_mm=lambda info: np.array([info["brier_score"]]),
        goal_mm=0.5,
        goal_is_below=True,
    ),
    position=_place,
    arrival="was named",
)
