"""`ViTac/Slip-v1`: hold a part under a load that grows with as little force as it takes, and set it down."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...scene.perspective import ActionArray
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, choose_shape, either_way, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import STANDING_MM, TASK
from .scene import SlipScene, SlipSettings, SlipShape, SlipStart, part_mesh, table_mesh

OFFSET = "offset_mm"
LARGEST_X_MM, LARGEST_Z_MM = 5.0, 10.0
CLEAR_MM = 0.5
"""Least height above the table at which the part has to hang while the load grows."""
LARGEST_FALL_MM = 1.5
"""By which the part may slide down in the grasp in an env step: by more than the gripper can rise."""
FREE_N = 0.02
"""Grip force below which the part is let go."""
LIFTED_MM = 3.0


class SlipEnv(TactileTaskEnv[SlipScene, SlipSettings]):
    """Lift a part, hold it while a load on it grows, and set it down, with as little force as it takes.

    The part stands on a table, just touched by both gels; its mass, its centre of mass and the friction of the gels on
    it are not told. Actions raise the gripper and change its width. From the start of env step 8 to the end of env step
    16 a load grows on the part, which has to hang clear of the table meanwhile. Then it is to be set down upright and
    let go. Actions outside -1 to 1 are clipped. World frame: z up, origin on the table below the part's middle.

    The grid of `marker_flow` is drawn again at every observation. Contacts are those of `arena-2`.

    Reset options: `shape` ("block", "bar", "column"), `offset_mm` (x, z: where it is grasped, from 30 mm above the
    middle of its lower face), and `rng_seed`, the integers that seed the episode's generator in place of the
    environment's own. What is left open is drawn: the shape, x within 1.5 mm and z within 3 mm.

    Ends: terminated by success (`end_reason` "success"); truncated by a jaw that crushes the part, as it presses with
    more than 1.5 times the force that is needed for all of the load ("force"); by a sensing surface that moved more
    than 1.5 mm ("tactile"); by a part that is not clear of the table while the load grows, or that slides down in the
    grasp by more than 1.5 mm in an env step ("error"); by 28 env steps ("steps"), or physics that did not converge
    ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `SlipSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = SlipSettings
    scene_type: ClassVar = SlipScene
    shape_type: ClassVar = SlipShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [*map(part_mesh, SlipShape), table_mesh()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: SlipSettings
    ) -> SlipStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x and z."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            x, z = random.uniform(-1.0, 1.0, 2).tolist()
            return SlipStart(shape=shape, x_mm=x * settings.random_x_mm, z_mm=z * settings.random_z_mm)
        expected = f"expected (x, z) in mm within {LARGEST_X_MM:g} and {LARGEST_Z_MM:g} mm either way"
        x_mm, z_mm = numbers(self.env_id, OFFSET, wanted, either_way(LARGEST_X_MM, LARGEST_Z_MM), expected)
        return SlipStart(shape=shape, x_mm=x_mm, z_mm=z_mm)

    def _error(self) -> float:
        scene = self.task_scene
        heights_mm = scene.heights_mm()
        if scene.env_steps < self.settings.load_last_step:
            return max(0.0, LIFTED_MM - float(heights_mm.min()))
        return float(heights_mm.max()) + scene.grasped.grip_force_n() / scene.largest_grip_n

    def _judge(self) -> Flags:
        scene, settings = self.task_scene, self.settings
        crushed = scene.grasped.peak_grip_force_n() > scene.largest_grip_n
        heights_mm = scene.heights_mm()
        dropped = scene.fallen_mm > LARGEST_FALL_MM or (scene.is_loading and bool((heights_mm < CLEAR_MM).any()))
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        stands = bool((heights_mm < STANDING_MM).all()) and scene.grasped.grip_force_n() < FREE_N
        return Flags(
            force_too_large=crushed,
            tactile_movement_too_large=tactile,
            error_too_large=dropped,
            too_many_steps=scene.env_steps >= settings.max_steps,
            is_success=stands and scene.env_steps > settings.load_last_step and not (crushed or tactile or dropped),
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        scene, settings = self.task_scene, self.settings
        strain = scene.grasped.grip_force_n() / scene.largest_grip_n
        reward = progress - settings.step_penalty * (1.0 + strain)
        if flags.has_failed:
            return reward - settings.failure_penalty
        return reward + (settings.final_reward if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "crushed": flags.force_too_large,
            "heights_mm": scene.heights_mm(),
            "relative_motion_mm": scene.relative_motion_mm(),
            "gripper_width_mm": 1e3 * scene.grasped.gripper_width_m,
            "load_n": float(scene.load_n()[0]),
            "grip_force_n": scene.grasped.grip_force_n(),
            "mean_grip_force_n": scene.mean_grip_force_n,
            "needed_grip_n": scene.needed_grip_n(),
            "largest_grip_n": scene.largest_grip_n,
            "is_loaded": scene.env_steps >= self.settings.load_last_step,
            "is_success": flags.is_success,
        }


# Of the force that friction needs, and of the way between two forces in an env step.
_MARGIN, _STIFFNESS_N_MM = 1.25, 30.0
# Grips of the env steps until the part hangs, each half as much again, the lift meanwhile, and from where on it hangs.
_GRIPS_N = (1.0, 1.5, 2.25, 3.375, 5.0625, 7.59375, 11.390625, 17.0859375)
_LIFT_MM, _HANGING_MM = 0.6, 0.3


def lift_ever_harder(_: Observation, info: Info) -> ActionArray:
    """Lift ever harder until the part hangs, grip a quarter harder than friction needs, and set down and let go.

    Who imitates this feels what the weight and the friction are.
    """
    lowest_mm, grip_n = info["heights_mm"].min(), info["grip_force_n"]
    wanted_n = _MARGIN * info["needed_grip_n"]
    up_mm, wider_mm = 0.0, min(0.0, (grip_n - wanted_n) / _STIFFNESS_N_MM)
    if info["is_loaded"]:
        up_mm = -min(1.0, lowest_mm)
        if lowest_mm < 0.5 * STANDING_MM:  # A part that leans rights itself once it is let go.
            up_mm, wider_mm = 0.0, 0.2
    elif lowest_mm < _HANGING_MM and info["load_n"] == 0.0:
        wanted_n = _GRIPS_N[min(info["steps"], len(_GRIPS_N) - 1)]
        up_mm, wider_mm = _LIFT_MM, (grip_n - wanted_n) / _STIFFNESS_N_MM
    elif grip_n > 0.9 * wanted_n:
        up_mm = min(1.0, max(0.0, LIFTED_MM - lowest_mm))
    action = np.array([up_mm, wider_mm]) / np.array(TASK.action_scale)
    return np.asarray(np.clip(action, -1.0, 1.0), dtype=np.float32)
