"""`ViTac/MovingHole-v1`: insert a peg into the hole of a plate that moves.

First its scene: how the plate moves, and a gripper that is commanded in the world above it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf, pi, radians
from typing import Any, ClassVar

import numpy as np

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.mesh import RigidBody, SurfaceMesh
from ...scene.grasped_scene import Clocks, PhysicsSettings
from ...scene.perspective import ActionArray, FloatArray, longest_action
from ..definition import Flags
from ..insertion.env import way_to_the_hole
from ..insertion.interface import PegOffset
from ..peg_insertion.env import OFFSET, PegInsertionEnv, PegInsertionSettings, PegScene, PegStart
from ..quantities import check_quantities
from ..settings import SHAPE, arena_physics, choice, either_way, numbers, require
from ..task_env import Info, Observation
from .definition import PLATE_SPEED, TASK

EARLIEST_START_S = 0.4
"""When the reset of the default settings has ended."""
SINE_PERIOD_S = 6.0
RUN_S, STAND_S = 1.2, 0.8
"""How long a conveyor runs, and stands."""


class PlateMotion(StrEnum):
    """How the plate moves along its line from its start on."""

    CONSTANT = "constant"
    """At its speed."""
    SINE = "sine"
    """To and fro in 6 s, at its speed in the middle."""
    CONVEYOR = "conveyor"
    """At its speed for 1.2 s, and not at all for 0.8 s, again and again."""


@dataclass(frozen=True, kw_only=True)
class PlatePath:
    """Where the plate is, as the motion of a fixed part.

    Attributes:
        motion: along the path.
        speed_mm_s: largest speed.
        direction_deg: of the path in the world, from x towards y.
        start_s: when it begins to move; 0 is when the scene was built, 0.4 s the end of the reset.
    """

    motion: PlateMotion
    speed_mm_s: float
    direction_deg: float
    start_s: float

    def __call__(self, time_s: float) -> FloatArray:
        """Return where the plate is from where it stood [m], shape [3]."""
        sine, cosine = sine_cosine(radians(self.direction_deg))
        along_m = 1e-3 * self.speed_mm_s * self._moving_s(max(0.0, time_s - self.start_s))
        return np.array([cosine * along_m, sine * along_m, 0.0])

    def _moving_s(self, since_s: float) -> float:
        """Return for how long it would have to move at its speed to be where it is."""
        if self.motion is PlateMotion.CONSTANT:
            return since_s
        if self.motion is PlateMotion.CONVEYOR:
            runs, rest_s = divmod(since_s, RUN_S + STAND_S)
            return runs * RUN_S + min(rest_s, RUN_S)
        turn = 2.0 * pi / SINE_PERIOD_S
        return sine_cosine(turn * since_s)[0] / turn


@dataclass(frozen=True, kw_only=True)
class MovingHoleSettings(PegInsertionSettings):
    """Those of the peg task, with values of this one.

    Attributes:
        ipc_steps: of an env step, which always takes the same time.
        plate_speed_mm_s: largest speed of the plate.
        latest_start_s: largest time from the reset's end to the start of a random path.
    """

    max_steps: int = 12
    z_step_mm: float = 0.08
    ipc_steps: int = 4
    plate_speed_mm_s: float = 0.8
    latest_start_s: float = 1.6
    physics: PhysicsSettings = field(default_factory=arena_physics)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_quantities(self, (PLATE_SPEED,))
        require(1 <= self.ipc_steps <= 100, "ipc_steps", self.ipc_steps, "1 to 100")
        require(0 <= self.latest_start_s <= 60, "latest_start_s", self.latest_start_s, "0 to 60 s")


@dataclass(frozen=True, kw_only=True)
class MovingHoleStart(PegStart):
    """Start of an episode, with the path of its plate."""

    path: PlatePath


class MovingHoleScene(PegScene):
    """A peg above a plate that moves; `offset` is that from its hole where this is now.

    Attributes:
        path: of the plate.
    """

    def __init__(self, *, start: MovingHoleStart, meshes: Meshes, settings: MovingHoleSettings, clocks: Clocks) -> None:
        self.path, self._steps_each = start.path, settings.ipc_steps
        # Where the plate is at the end of the gripper's present motion.
        self._plate_mm = np.zeros(2)
        super().__init__(start=start, meshes=meshes, settings=settings, clocks=clocks)

    def move(self, command: FloatArray) -> None:
        """Move the gripper in the world as an action says, and one z step down with it, while the plate moves."""
        dx, dy, dtheta = self._scaled(command)
        away = self.plate_step_mm()
        self._plate_mm = self._plate_mm + away
        self._z_mm -= self._settings.z_step_mm
        now = self.offset
        goal = PegOffset(
            x_mm=now.x_mm + dx - float(away[0]), y_mm=now.y_mm + dy - float(away[1]), theta_deg=now.theta_deg + dtheta
        )
        self._travel(goal, ipc_steps=self._steps_each, raised_mm=self._z_mm)

    def plate_step_mm(self) -> FloatArray:
        """Return how far the plate moves in the next env step [mm], shape [2]."""
        time_s, step_s = self.grasped.time_s, self._steps_each * self._settings.physics.time_step_s
        return 1e3 * (self.path(time_s + step_s) - self.path(time_s))[:2]

    def relative_motion_mm_deg(self) -> FloatArray:
        """Return the commanded x, y, theta, z in the world since the reset [mm, mm, deg, mm]."""
        motion = super().relative_motion_mm_deg()
        motion[:2] += self._plate_mm
        return motion

    def _place_fixed(self, mesh: SurfaceMesh, friction: float) -> RigidBody:
        return replace(super()._place_fixed(mesh, friction), motion=self.path)

    def _lower_end_mm(self, offset: PegOffset) -> tuple[float, float, float]:
        x_mm, y_mm, z_mm = super()._lower_end_mm(offset)
        return x_mm + float(self._plate_mm[0]), y_mm + float(self._plate_mm[1]), z_mm


MOTION, DIRECTION, START = "plate_motion", "plate_direction_deg", "plate_start_s"


class MovingHoleEnv(PegInsertionEnv):
    """Insert a peg into the hole of a plate that begins to move, by touch alone.

    As `ViTac/PegInsertion-v1`, but some time after the reset the plate begins to move: at a constant speed, to and fro,
    or as a conveyor that runs and stops. The policy observes neither that time nor the direction. The plate drags at
    the peg that is pressed on it. Every env step takes the same time, 0.4 s, in which the gripper moves in the world as
    the action says and 0.08 mm down, all together. Contacts are those of `arena-2`.

    Reset options: `shape`, `offset_mm_deg` and `rng_seed` as there, `plate_motion` ("constant", "sine", "conveyor"),
    `plate_direction_deg` (from x towards y), and `plate_start_s`, of which 0.4 is the reset's end. What is left open
    is drawn.

    Ends: as there, after 12 env steps; the offset that may not be beyond 12 mm is that from the hole where it is.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `MovingHoleSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = MovingHoleSettings
    scene_type: ClassVar = MovingHoleScene
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, MOTION, DIRECTION, START)

    def choose_start(self, options: Mapping[str, Any], random: np.random.Generator, settings: Any) -> MovingHoleStart:
        """Return the start that the options give; what they leave open is drawn: first the peg's, then the path."""
        start = super().choose_start(options, random, settings)
        path = self._choose_path(options, random, settings)
        return MovingHoleStart(shape=start.shape, offset=start.offset, path=path)

    def _choose_path(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: MovingHoleSettings
    ) -> PlatePath:
        """Return the path that the options give; what they leave open is drawn: motion, direction and start."""
        kind, turn, late = int(random.integers(len(PlateMotion))), random.random(), random.random()
        given = options.get(MOTION)
        motion = list(PlateMotion)[kind] if given is None else choice(self.env_id, MOTION, given, PlateMotion)
        drawn = {DIRECTION: 360.0 * turn, START: EARLIEST_START_S + settings.latest_start_s * late}
        direction_deg, start_s = (
            numbers(self.env_id, name, [options.get(name, value)], either_way(inf), "expected a number")[0]
            for name, value in drawn.items()
        )
        speed_mm_s = settings.plate_speed_mm_s
        return PlatePath(motion=motion, speed_mm_s=speed_mm_s, direction_deg=direction_deg, start_s=start_s)

    def _info(self, flags: Flags) -> Info:
        scene: Any = self.task_scene
        shift_mm = 1e3 * scene.grasped.fixed_shift_m()[:2]
        return {**super()._info(flags), "plate_mm": shift_mm, "plate_step_mm": scene.plate_step_mm()}


def to_where_the_hole_will_be(_: Observation, info: Info) -> ActionArray:
    """Take the offset away that is left if the gripper rests while the plate moves."""
    offset_mm_deg = info["gt_offset_mm_deg"].copy()
    offset_mm_deg[:2] -= info["plate_step_mm"]
    return longest_action(np.array(way_to_the_hole(offset_mm_deg.tolist())), np.array(TASK.action_scale))
