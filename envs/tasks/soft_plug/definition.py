"""The soft plug and the cable's end as others need to know them: actions, observables, measure, how they are drawn.

Light to import.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np

from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, marker_flow, played_shape
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ...tactile.gel import ARENA_SENSING_NODES
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, Better, Measure, TaskDefinition
from ..quantities import TOUCH_QUANTITIES, Quantity

SUCCESS_DEPTH_MM = 4.0
"""How deep all corners of the plug's lower face must be below the rim."""

PLUG_QUANTITIES = MODULUS, INTERFERENCE = (
    Quantity(name="plug_modulus_mpa", unit="MPa", meaning="Young's modulus of the plug", range=(0.7, 6.0), nominal=1.5),
    Quantity(
        name="interference_mm",
        unit="mm",
        meaning="Interference of plug and hole on each side",
        range=(-0.3, 0.3),
        nominal=0.1,
    ),
)


class HasPlug(Protocol):
    """A scene with an elastic plug above its hole."""

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded motion of the gripper since the start [mm], shape (3,)."""

    def offset_mm(self) -> FloatArray:
        """Return where the gripper holds the plug beside its hole [mm], shape (2,)."""

    def lower_end_mm(self) -> FloatArray:
        """Return the middle of the plug's lower face [mm], shape (3,)."""

    def bend_mm(self) -> float:
        """Return how far the plug's lower end or its neck is beside where the gripper holds it [mm]."""


_OWN: tuple[Observable[HasPlug], ...] = (
    Observable(
        name="relative_motion",
        shape=(3,),
        unit="mm",
        meaning="Commanded gripper motion [x, y, z] since the start; world frame.",
        read=lambda scene, _: scene.relative_motion_mm(),
    ),
    Observable(
        name="gt_offset",
        shape=(2,),
        unit="mm",
        meaning="[x, y] of the gripper from the axis of the hole; world frame.",
        read=lambda scene, _: scene.offset_mm(),
        privileged=True,
    ),
    Observable(
        name="lower_end",
        shape=(3,),
        unit="mm",
        meaning="[x, y, z] of the middle of the plug's lower face, from that of the hole's rim; world frame.",
        read=lambda scene, _: scene.lower_end_mm(),
        privileged=True,
    ),
)

BEND = Measure(
    name="largest_bend_mm",
    label="bend",
    meaning="largest sideways motion of the plug's lower end",
    unit="mm",
    needs=("largest_bend_mm",),
    read=lambda info: (info["largest_bend_mm"],),
    better=Better.LOW,
)
"""Largest distance of the plug's lower end from below the gripper at the ends of the env steps so far [mm]."""

PLUG_TASK = TaskDefinition(
    env_id="ViTac/SoftPlug-v1",
    environment="vitac.envs.tasks.soft_plug.env:SoftPlugEnv",
    actions=(
        ActionComponent(name="x", scale=1.0, unit="mm", meaning="Gripper motion along x."),
        ActionComponent(name="y", scale=1.0, unit="mm", meaning="Gripper motion along y, from jaw to jaw."),
        ActionComponent(name="z", scale=1.0, unit="mm", meaning="Gripper motion upwards. All are moved together."),
    ),
    observables=(
        *_OWN,
        marker_flow("u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
        played_shape("stopper, slim"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(BEND, SURFACE_DIFF),
    perspective="vitac.envs.tasks.soft_plug.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.soft_plug.env:touch_then_push",
    guides_exactly=True,
    accepts_start="vitac.envs.tasks.soft_plug.env:accepts_start",
    quantities=(*TOUCH_QUANTITIES, *PLUG_QUANTITIES),
    info_lengths={"heights_mm": 4},
)

_SHAPE = played_shape("cable")
CABLE_TASK = replace(
    PLUG_TASK,
    env_id="ViTac/CableEnd-v1",
    environment="vitac.envs.tasks.soft_plug.env:CableEndEnv",
    observables=tuple(_SHAPE if entry.name == _SHAPE.name else entry for entry in PLUG_TASK.observables),
    measures=(
        replace(BEND, meaning="largest sideways motion of the connector's lower end or of the boot's neck"),
        SURFACE_DIFF,
    ),
    perspective="vitac.envs.tasks.soft_plug.definition:CABLE_PERSPECTIVE",
)

TASKS = (PLUG_TASK, CABLE_TASK)


def _position(info: InfoView) -> str:
    x_mm, y_mm = info["gt_offset_mm"].tolist()
    return f"x {signed(x_mm)} mm, y {signed(y_mm)} mm, bend {info['bend_mm']:.1f} mm"


_MIDDLE = Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0)

PERSPECTIVE = Perspective(
    held_name="plug",
    fixed_name="plate",
    azimuth_deg=-24.0,
    elevation_deg=14.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=_MIDDLE,
    section=SectionView(
        title="plug and hole from the side",
        held_cut=_MIDDLE,
        fixed_cut=_MIDDLE,
        axes=((1, "y"), (2, "z")),
        limits_mm=((-36.0, 36.0), (-11.0, 43.0)),
    ),
    progress=ProgressPlot(
        title="plug above rim [mm]",
        heights_mm=lambda info: np.asarray(info["heights_mm"]),
        goal_mm=-SUCCESS_DEPTH_MM,
        goal_is_below=True,
    ),
    position=_position,
    arrival="was plugged in",
)

CABLE_PERSPECTIVE: Perspective = replace(
    PERSPECTIVE,
    held_name="cable end",
    section=replace(
        PERSPECTIVE.section, title="cable end and hole from the side", limits_mm=((-36.0, 36.0), (-11.0, 48.0))
    ),
    progress=replace(PERSPECTIVE.progress, title="connector above rim [mm]"),
)
