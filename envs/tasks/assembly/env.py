"""`ViTac/Assembly-v1`: fetch a part from a tray, put it into a socket and turn it until it locks."""

from collections.abc import Mapping
from math import radians
from typing import Any, ClassVar

import numpy as np

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import SurfaceMesh
from ...geometry.bayonet import SOCKET_X_MM, TURN_DEG, tray_and_socket
from ...scene.perspective import ActionArray, FloatArray
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, choose_shape, either_way, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import TASK, AssemblyStage
from .scene import (
    FETCHED_ABOVE_MM,
    INSERTED_BELOW_MM,
    AssemblyScene,
    AssemblySettings,
    AssemblyStart,
    HeadShape,
    part_mesh,
)

OFFSET = "offset_mm_deg"
LARGEST_MM_DEG = (4.5, 1.0, 10.0)
# Lowest and highest commanded motion since the start: x, y, z [mm], theta [deg].
RANGE_MM_DEG = ((-12.0, 38.0), (-8.0, 8.0), (-8.0, 16.0), (-40.0, 90.0))
LARGEST_TILT_MM = 5.0
"""By how much a lower corner of the part may be higher than another one: it then tilts by 15 degrees."""
LOWEST_MM = -12.0
_ROUNDING_MM = 1e-5


class AssemblyEnv(TactileTaskEnv[AssemblyScene, AssemblySettings]):
    """Fetch a part from a tray, put its lugs through the opening of a socket, and turn them below its lip, by touch.

    The part stands in a tray of 20 x 22 mm, up to 4.5 mm beside its middle and turned by up to 10 degrees, and the open
    gripper is over the middle. Closed on it the gripper centres it along y only: where it is held along x, and turned,
    is in the markers. The opening of the socket has 0.7 mm of clearance on all sides, 3 mm below it the lugs can turn
    towards positive theta, and after 60 degrees they meet stops. Actions move the gripper in the world, turn it about
    its own middle and change its width. Actions outside -1 to 1 are clipped. World frame: z up, the plate's top at
    z = 0, the tray's middle at x = y = 0, its floor 3 mm deep, and the socket's middle at x = 26 mm.

    Stages, of which the furthest one reached is scored: fetched (1): all of the part's lower end was more than 0.3 mm
    above the plate; aligned (2): all of it was over the opening or in it, lower than 2 mm above the plate; inserted
    (3): it was lower than 7 mm below the plate, which has the lugs below the lip; locked (4): the lugs were turned
    there by at least 57 degrees. An env step takes 0.2 s.

    The grid of `marker_flow` is drawn again at every observation. Contacts are those of `arena-2`.

    Reset options: `shape` ("narrow", "wide": the part's head), `offset_mm_deg` (x, y, theta of the part in the tray),
    and `rng_seed`, the integers that seed the episode's generator in place of the environment's own. What is left open
    is drawn: the shape, x within 4.5 mm, y within 1 mm, and theta within 10 degrees.

    Ends: terminated by success, the fourth stage (`end_reason` "success"); truncated by a sensing surface that moved
    more than 1.5 mm ("tactile"); by a gripper that left its range of -12 to 38 mm along x, 8 mm either way along y, -8
    to 16 mm upwards (it stops above the plate, at -10 mm) and -40 to 90 degrees from the start, or a part that fell
    over, tilted by more than 15 degrees, or fell off ("error"); by 40 env steps ("steps"), or physics that did not
    converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `AssemblySettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = AssemblySettings
    scene_type: ClassVar = AssemblyScene
    shape_type: ClassVar = HeadShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [*map(part_mesh, HeadShape), tray_and_socket()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: AssemblySettings
    ) -> AssemblyStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x, y and theta."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
            return AssemblyStart(
                shape=shape,
                x_mm=x * settings.random_x_mm,
                y_mm=y * settings.random_y_mm,
                theta_deg=theta * settings.random_theta_deg,
            )
        expected = (
            f"expected (x mm, y mm, theta deg) within {', '.join(f'{value:g}' for value in LARGEST_MM_DEG)} either way"
        )
        x_mm, y_mm, theta_deg = numbers(self.env_id, OFFSET, wanted, either_way(*LARGEST_MM_DEG), expected)
        return AssemblyStart(shape=shape, x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)

    def _error(self) -> float:
        """Return the stages that are left, the next one in parts."""
        stage, (x, y, z, theta) = self.task_scene.stage, self.task_scene.offset_mm_deg().tolist()
        left = (
            (FETCHED_ABOVE_MM - z) / 3.0,
            (abs(x) + abs(y) + abs(theta) + max(0.0, z)) / 40.0,
            (z - INSERTED_BELOW_MM) / 10.0,
            (TURN_DEG - theta) / TURN_DEG,
            0.0,
        )
        return max(0, AssemblyStage.LOCKED - stage - 1) + min(1.0, max(0.0, left[stage]))

    def _judge(self) -> Flags:
        scene = self.task_scene
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        heights_mm = scene.heights_mm()
        lost = float(heights_mm.max() - heights_mm.min()) > LARGEST_TILT_MM or float(heights_mm.min()) < LOWEST_MM
        error = lost or self._left_range(scene.relative_motion_mm_deg())
        return Flags(
            tactile_movement_too_large=tactile,
            error_too_large=error,
            too_many_steps=scene.env_steps >= self.settings.max_steps,
            is_success=scene.stage is AssemblyStage.LOCKED and not (tactile or error),
        )

    def _left_range(self, motion: FloatArray) -> bool:
        pairs = zip(motion.tolist(), RANGE_MM_DEG, strict=True)
        return any(not low - _ROUNDING_MM <= value <= high + _ROUNDING_MM for value, (low, high) in pairs)

    def _reward(self, flags: Flags, progress: float) -> float:
        settings = self.settings
        reward = settings.stage_reward * progress - settings.step_penalty
        return reward - (settings.failure_penalty if flags.has_failed else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "stage": int(scene.stage),
            "offset_mm_deg": scene.offset_mm_deg(),
            "relative_motion_mm_deg": scene.relative_motion_mm_deg(),
            "gripper_width_mm": 1e3 * scene.grasped.gripper_width_m,
            "grip_force_n": scene.grasped.grip_force_n(),
            "is_success": flags.is_success,
        }


# Heights of the part's lower end that the expert goes for, above the plate; it is in the opening below the third one.
_CARRIED_MM, _INSERTED_MM, _IN_MM = 1.2, -7.8, -0.5
# How far beside the opening the part already goes down, to slide over the rim pressed on it.
_NEARBY_MM, _RIM_MM = 2.5, -0.1
# Width at which the gels do not touch the head yet, the grip force, and the force of a jaw by how far it closes on.
_NEAR_MM, _GRIP_N, _STIFFNESS_N_MM = 30.8, 20.0, 45.0


def fetch_insert_and_turn(_: Observation, info: Info) -> ActionArray:
    """Close on the part, carry it straight over the socket, put it in and turn it against the stops.

    It is gripped where it is, and where it comes to the socket beside the opening it goes down and slides over the rim:
    who imitates this feels how it is held, and that it is not over the opening yet.
    """
    x_mm, y_mm, z_mm, theta_deg = info["offset_mm_deg"].tolist()
    gone = info["relative_motion_mm_deg"].tolist()
    arm_mm = (gone[0] - x_mm - SOCKET_X_MM, gone[1] - y_mm)
    closing_mm = (_GRIP_N - info["grip_force_n"]) / _STIFFNESS_N_MM
    if info["stage"] == AssemblyStage.NOTHING and info["grip_force_n"] < 0.6 * _GRIP_N:
        to_near_mm = info["gripper_width_mm"] - _NEAR_MM
        return _scaled([0.0, 0.0, 0.0, 0.0, -(to_near_mm if to_near_mm > 1e-3 else closing_mm)])
    aside_mm, turned_deg = max(abs(x_mm), abs(y_mm)), abs(theta_deg)
    way = [-x_mm, -y_mm, _CARRIED_MM - z_mm, -theta_deg]
    if aside_mm < _NEARBY_MM and z_mm < INSERTED_BELOW_MM - 0.3:
        way[2:] = [_INSERTED_MM - z_mm, TURN_DEG - theta_deg]
    elif (aside_mm < _NEARBY_MM and z_mm < _IN_MM) or (aside_mm < 0.5 and turned_deg < 3.0):
        way[2] = _INSERTED_MM - z_mm
    elif aside_mm < _NEARBY_MM and turned_deg < 10.0:
        way[2] = _RIM_MM - z_mm
    elif z_mm < FETCHED_ABOVE_MM:
        way[:2] = [0.0, 0.0]
    part = _longest(way)
    # The gripper turns about its own middle, which is an arm away from the part's.
    sine, cosine = sine_cosine(radians(part[3]))
    part[0] += cosine * arm_mm[0] - sine * arm_mm[1] - arm_mm[0]
    part[1] += sine * arm_mm[0] + cosine * arm_mm[1] - arm_mm[1]
    return _scaled([*part, -closing_mm])


def _longest(way: list[float]) -> list[float]:
    """Return the longest motion in an env step along a straight line that does not go beyond its end."""
    longest = max(1.0, *(abs(value) / scale for value, scale in zip(way, TASK.action_scale, strict=False)))
    return [value / longest for value in way]


def _scaled(motion: list[float]) -> ActionArray:
    return np.asarray(np.clip(np.array(motion) / np.array(TASK.action_scale), -1.0, 1.0), dtype=np.float32)
