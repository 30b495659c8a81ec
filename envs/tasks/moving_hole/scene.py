"""Scene of the moving hole: how the plate moves, and a gripper that is commanded in the world above it."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import pi, radians

import numpy as np

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.mesh import RigidBody, SurfaceMesh
from ...scene.grasped_scene import Clocks, PhysicsSettings
from ...scene.perspective import FloatArray
from ..insertion.interface import PegOffset
from ..peg_insertion.scene import PegInsertionSettings, PegScene, PegStart
from ..quantities import check_quantities
from ..settings import arena_physics, require
from .definition import PLATE_SPEED

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
