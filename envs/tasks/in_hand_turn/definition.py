"""The turn in the hand as others need to know it: actions, observables, measure, how it is drawn; light to import."""

from typing import Protocol

import numpy as np

from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, marker_flow, played_shape
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ...tactile.gel import ARENA_SENSING_NODES
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, Better, Measure, TaskDefinition
from ..quantities import TOUCH_QUANTITIES, symmetric

TOLERANCE_DEG = 0.5
"""Largest error of the angle that counts as success."""

HELD = symmetric(name="held_mm", unit="mm", meaning="Grasp along the rod above its nominal place", largest=4.0)


class HasRod(Protocol):
    """A scene with a rod that is to be turned between the gels."""

    @property
    def goal_deg(self) -> float:
        """Angle to which it is to be turned."""

    def angle_deg(self) -> float:
        """Return its angle now [deg]."""

    def edge_mm(self) -> FloatArray:
        """Return where the edge is from the gripper's centre, [x, z] [mm], shape (2,)."""

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded motion since the start, [x, z] [mm], shape (2,)."""


GOAL: Observable[HasRod] = Observable(
    name="goal_angle",
    shape=(1,),
    unit="degree",
    meaning="Angle from the vertical that the rod is to have, positive where its lower end points away from the edge.",
    read=lambda scene, _: np.array([scene.goal_deg]),
)
RELATIVE_MOTION: Observable[HasRod] = Observable(
    name="relative_motion",
    shape=(2,),
    unit="mm",
    meaning="Commanded gripper motion [dx, dz] since the start; world frame, x towards the edge, z up.",
    read=lambda scene, _: scene.relative_motion_mm(),
)
ROD_ANGLE: Observable[HasRod] = Observable(
    name="rod_angle",
    shape=(1,),
    unit="degree",
    meaning="Angle of the rod now, as goal_angle counts it.",
    read=lambda scene, _: np.array([scene.angle_deg()]),
    privileged=True,
)
EDGE: Observable[HasRod] = Observable(
    name="gt_edge",
    shape=(2,),
    unit="mm",
    meaning="Where the edge is from the gripper's centre, [x, z]; world frame.",
    read=lambda scene, _: scene.edge_mm(),
    privileged=True,
)

ANGLE_ERROR = Measure(
    name="angle_error_deg",
    label="angle error",
    meaning="error of the rod's angle",
    unit="degree",
    needs=("angle_error_deg",),
    read=lambda info: (float(info["angle_error_deg"]),),
    better=Better.LOW,
)
"""How far the rod is from its goal where it was free last: after the end of an episode, or else at its start."""

TASK = TaskDefinition(
    env_id="ViTac/InHandTurn-v1",
    environment="vitac.envs.tasks.in_hand_turn.env:InHandTurnEnv",
    actions=(
        ActionComponent(name="x", scale=5.0, unit="mm", meaning="Gripper motion along x, towards the edge."),
        ActionComponent(name="z", scale=2.0, unit="mm", meaning="Gripper motion up. Both are moved together."),
    ),
    observables=(
        GOAL,
        RELATIVE_MOTION,
        marker_flow("u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
        ROD_ANGLE,
        EDGE,
        played_shape("narrow, wide"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(ANGLE_ERROR, SURFACE_DIFF),
    start_labels=("gap {} mm", "rod at {}°", "goal {}°"),
    perspective="vitac.envs.tasks.in_hand_turn.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.in_hand_turn.env:press_until_it_stays",
    can_go_back=False,
    quantities=(*TOUCH_QUANTITIES, HELD),
)


def _position(info: InfoView) -> str:
    return f"rod at {signed(info['angle_deg'])}°, goal {signed(info['goal_deg'])}°"


_MIDDLE = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0)

PERSPECTIVE = Perspective(
    held_name="rod",
    fixed_name="edge",
    azimuth_deg=-58.0,
    elevation_deg=20.0,
    gel_labels=(Beside.ABOVE, Beside.BELOW),
    cut=_MIDDLE,
    section=SectionView(
        title="rod and edge from the side",
        held_cut=_MIDDLE,
        fixed_cut=_MIDDLE,
        axes=((0, "x"), (2, "z")),
        limits_mm=((-50.0, 60.0), (-35.0, 50.0)),
    ),
    progress=ProgressPlot(
        title="angle from the goal [deg]",
        heights_mm=lambda info: np.array([abs(info["goal_deg"] - info["angle_deg"])]),
        goal_mm=TOLERANCE_DEG,
        goal_is_below=True,
    ),
    position=_position,
    arrival="has turned",
)
