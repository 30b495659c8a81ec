"""`ViTac/SoftPlug-v1`, `ViTac/CableEnd-v1`: push an elastic plug, or a connector on a soft boot, into a hole."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...scene.perspective import ActionArray
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, choose_shape, either_way, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import CABLE_TASK, PLUG_TASK, SUCCESS_DEPTH_MM
from .scene import CableEndSettings, CableShape, PlugShape, SoftPlugScene, SoftPlugSettings, SoftPlugStart, plate_mesh

OFFSET = "offset_mm"
LARGEST_XY_MM = 8.0
LEAST_MM = 1.2
"""Least |x| or |y| of a random start: the plug then does not just slide in."""


class SoftPlugEnv(TactileTaskEnv[SoftPlugScene, SoftPlugSettings]):
    """Push an elastic plug into a tight hole by touch alone, without crushing it or letting it buckle.

    Two gels hold a plug of rubber by its upper part. Below it is a plate with a hole that is narrower than the plug,
    with a wider mouth, a few millimetres beside it. Pressed on the plate the plug shortens, bends and slides; inside
    the hole its walls press on it. The policy moves the gripper along x, y and z. World frame: z up, origin in the
    middle of the hole's rim, y from jaw to jaw. Actions outside -1 to 1 are clipped. Contacts are those of `arena-2`.

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("stopper", "slim"), `offset_mm` (x, y of plug and gripper from the hole), and `rng_seed`,
    the integers that seed the episode's generator in place of the environment's own. What is left open is drawn: the
    shape, then x and y within 3 mm, one of them at least 1.2 mm.

    Ends: terminated by success, as soon as all corners of the plug's lower face are 4 mm below the rim (`end_reason`
    "success"); truncated by a force on the plug beyond `force_limit_n`, if that is given ("force"); by a sensing
    surface that moved more than 1.5 mm ("tactile"); by a lower end that is more than 1.5 mm beside where the gripper
    holds the plug, which has buckled, or a gripper more than 8 mm beside the hole ("error"); by 24 env steps ("steps"),
    or physics that did not converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `SoftPlugSettings`.
    """

    task: ClassVar = PLUG_TASK
    settings_type: ClassVar = SoftPlugSettings
    scene_type: ClassVar = SoftPlugScene
    shape_type: ClassVar[type[PlugShape | CableShape]] = PlugShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [plate_mesh(shape, self.settings.interference_mm) for shape in self.shape_type]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: SoftPlugSettings
    ) -> SoftPlugStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x and y."""
        shape = choose_shape(self.env_id, options, self._shapes, random)
        drawn = [0.0, 0.0]
        while not accepts_start(shape, drawn):
            drawn = (settings.random_xy_mm * random.uniform(-1.0, 1.0, 2)).tolist()
        wanted, ranges = options.get(OFFSET, drawn), either_way(LARGEST_XY_MM, LARGEST_XY_MM)
        expected = f"expected (x, y) in mm within {LARGEST_XY_MM:g} mm either way"
        x_mm, y_mm = numbers(self.env_id, OFFSET, wanted, ranges, expected)
        return SoftPlugStart(shape=shape, x_mm=x_mm, y_mm=y_mm)

    def _error(self) -> float:
        scene = self.task_scene
        x, y = scene.offset_mm().tolist()
        return float(np.sqrt(x * x + y * y)) + max(0.0, float(scene.heights_mm().max()) + SUCCESS_DEPTH_MM)

    def _judge(self) -> Flags:
        scene, settings = self.task_scene, self.settings
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        buckled = scene.bend_mm() > settings.largest_bend_mm
        left = bool((np.abs(scene.offset_mm()) > LARGEST_XY_MM).any())
        is_in = bool((scene.heights_mm() < -SUCCESS_DEPTH_MM).all())
        return Flags(
            tactile_movement_too_large=tactile,
            error_too_large=buckled or left,
            too_many_steps=scene.env_steps >= settings.max_steps,
            is_success=is_in and not (tactile or buckled or left),
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        settings = self.settings
        reward = progress - settings.step_penalty
        if flags.has_failed:
            return reward - settings.failure_penalty
        return reward + (settings.final_reward if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "heights_mm": scene.heights_mm(),
            "bend_mm": scene.bend_mm(),
            "largest_bend_mm": scene.largest_bend_mm,
            "gt_offset_mm": scene.offset_mm(),
            "relative_motion_mm": scene.relative_motion_mm(),
            "is_success": flags.is_success,
        }


class CableEndEnv(SoftPlugEnv):
    """Push a cable's connector into its hole by touch alone, without crushing it or letting its boot buckle.

    As `ViTac/SoftPlug-v1`, from which it differs so: what is held is a boot of rubber, whose neck of 3 mm carries a
    hard connector, and the hole is wider than the connector. Pressed on the plate the neck bends or buckles.

    Reset options: `shape` ("cable"), `offset_mm` (x, y of connector and gripper from the hole), and `rng_seed`.

    Ends: as `ViTac/SoftPlug-v1`; the boot has buckled where the connector's lower end or the boot's neck is more than
    2 mm beside where the gripper holds it; 20 env steps.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `CableEndSettings`.
    """

    task: ClassVar = CABLE_TASK
    settings_type: ClassVar = CableEndSettings
    shape_type: ClassVar = CableShape


def accepts_start(_: str, offset_mm: Sequence[float]) -> bool:
    """Return whether an episode may start there: the plug must not just slide in."""
    return max(map(abs, offset_mm)) >= LEAST_MM


# Beside the hole, where its mouth still catches the plug; where the gripper goes to touch the plate, and above the rim.
_OVER_MM, _TOUCHING_MM, _ABOVE_MM = 0.5, -1.4, 0.3
# Env steps of a touch, and of it with the way that follows.
_TOUCH_STEPS, _CYCLE_STEPS = 2, 5


def touch_then_push(_: Observation, info: Info) -> ActionArray:
    """Touch the plate, go over the hole above it, and push; where that is beside the hole, it is the next touch.

    Who imitates this feels where the hole is, as often as it takes.
    """
    aside_mm = -info["gt_offset_mm"]
    if float(np.abs(aside_mm).max()) <= _OVER_MM:
        motion_mm = np.append(aside_mm, -1.0)
    elif info["steps"] % _CYCLE_STEPS < _TOUCH_STEPS:
        motion_mm = np.array([0.0, 0.0, _TOUCHING_MM - info["relative_motion_mm"][2]])
    else:
        motion_mm = np.append(aside_mm, max(0.0, _ABOVE_MM - info["heights_mm"].min()))
    return np.asarray(np.clip(motion_mm / np.array(PLUG_TASK.action_scale), -1.0, 1.0), dtype=np.float32)
