"""The assembly task as others need to know it: stages, actions, observables, how it is drawn; light to import."""

from enum import IntEnum
from typing import Protocol

import numpy as np

from ...observable import Observable
from ...scene.observables import (
    CONTACT_FORCES,
    GRIPPER_WIDTH,
    MEASURED_POSE,
    SURFACE_POINTS,
    marker_flow,
    played_shape,
)
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ...tactile.gel import ARENA_SENSING_NODES
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, Better, Measure, TaskDefinition
from ..quantities import TOUCH_QUANTITIES


class AssemblyStage(IntEnum):
    """What has been done of an assembly; each asks for those before it."""

    NOTHING = 0
    FETCHED = 1
    """All of the part's lower end was above the plate."""
    ALIGNED = 2
    """All of it was over the opening of the socket or in it, lower than 2 mm above the plate."""
    INSERTED = 3
    """The lugs were below the lip."""
    LOCKED = 4
    """They were turned below it by at least 57 of 60 degrees."""


class Assembles(Protocol):
    """A scene in which a gripper carries a part from a tray to a socket."""

    def relative_motion_mm_deg(self) -> FloatArray:
        """Return the commanded motion since the start, [x, y, z, theta] [mm, mm, mm, deg], shape (4,)."""

    def offset_mm_deg(self) -> FloatArray:
        """Return where the part is from the socket, [x, y, z, theta] [mm, mm, mm, deg], shape (4,)."""


_OWN: tuple[Observable[Assembles], ...] = (
    Observable(
        name="relative_motion",
        shape=(4,),
        unit="mm, mm, mm, degree",
        meaning=(
            "Commanded motion of the gripper [x, y, z, theta] since the start, at which it is over the middle of the "
            "tray; world frame. The socket is at x = 26 mm."
        ),
        read=lambda scene, _: scene.relative_motion_mm_deg(),
    ),
    Observable(
        name="gt_offset",
        shape=(4,),
        unit="mm, mm, mm, degree",
        meaning=(
            "Where the middle of the part's lower end is from that of the socket's opening, [x, y, z], and by how much "
            "the part is turned from where it goes in; world frame."
        ),
        read=lambda scene, _: scene.offset_mm_deg(),
        privileged=True,
    ),
)

STAGES = Measure(
    name="stages",
    label="stages",
    meaning="mean number of stages reached",
    unit="1",
    needs=("stage",),
    read=lambda info: (float(info["stage"]),),
    better=Better.HIGH,
    of_no_env_step=float(AssemblyStage.NOTHING),
)
"""Which of fetched, aligned, inserted and locked were reached, 0 to 4."""


def _move(name: str, scale: float, unit: str, meaning: str) -> ActionComponent:
    return ActionComponent(name=name, scale=scale, unit=unit, meaning=meaning)


TASK = TaskDefinition(
    env_id="ViTac/Assembly-v1",
    environment="vitac.envs.tasks.assembly.env:AssemblyEnv",
    actions=(
        _move("x", 6.0, "mm", "Gripper motion along x of the world, from the tray to the socket."),
        _move("y", 3.0, "mm", "Gripper motion along y of the world."),
        _move("z", 3.0, "mm", "Gripper motion up."),
        _move("theta", 6.0, "degree", "Turn of the gripper about the vertical through its own middle."),
        _move("width", 2.0, "mm", "Change of the gripper's width; negative values close it. All are done together."),
    ),
    observables=(
        *_OWN,
        GRIPPER_WIDTH,
        marker_flow("At theta = 0, u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
        played_shape("narrow, wide"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(STAGES, SURFACE_DIFF),
    perspective="vitac.envs.tasks.assembly.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.assembly.env:fetch_insert_and_turn",
    guides_exactly=True,
    # The grip is the policy's own.
    quantities=tuple(each for each in TOUCH_QUANTITIES if each.name != "indentation_mm"),
)


def _position(info: InfoView) -> str:
    x_mm, y_mm, z_mm, turn_deg = info["offset_mm_deg"]
    place = f"{signed(x_mm)}, {signed(y_mm)}, {signed(z_mm)} mm, {signed(turn_deg)}° from the socket"
    return f"stage {int(info['stage'])} of {int(AssemblyStage.LOCKED)}, {place}, grip {info['grip_force_n']:z.1f} N"


_MIDDLE = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0)

PERSPECTIVE = Perspective(
    held_name="part",
    fixed_name="tray and socket",
    azimuth_deg=-24.0,
    elevation_deg=20.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=26e-3),
    section=SectionView(
        title="part, tray and socket from the side",
        held_cut=_MIDDLE,
        fixed_cut=_MIDDLE,
        axes=((0, "x"), (2, "z")),
        limits_mm=((-22.0, 58.0), (-14.0, 46.0)),
    ),
    progress=ProgressPlot(
        title="stages reached",
        heights_mm=lambda info: np.array([float(info["stage"])]),
        goal_mm=float(AssemblyStage.INSERTED),
        goal_is_below=False,
    ),
    position=_position,
    arrival="is locked",
)
