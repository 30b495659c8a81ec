"""Base of the environments that insert a peg which is held between two tactile sensors."""

from typing import Any, TypeVar

from ..ending import Flags
from ..task_env import Info, TactileTaskEnv
from .info import InsertionInfo
from .offset import PegOffset
from .reward import insertion_reward
from .scene import InsertionScene
from .settings import InsertionSettings

SceneT = TypeVar("SceneT", bound=InsertionScene[Any, Any])
SettingsT = TypeVar("SettingsT", bound=InsertionSettings)


class InsertionEnv(TactileTaskEnv[SceneT, SettingsT]):
    """What the insertion tasks are rewarded for and tell; a task adds its scene, its starts and its goal."""

    def _error(self) -> float:
        offset: PegOffset = self.task_scene.offset
        return offset.magnitude()

    def _reward(self, flags: Flags, progress: float) -> float:
        return insertion_reward(flags, self.settings, progress=progress, env_steps=self.task_scene.env_steps)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        state = scene.state()
        info: InsertionInfo = {
            "steps": state.env_steps,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "too_many_steps": flags.too_many_steps,
            "error_too_large": flags.error_too_large,
            "peg_relative_z_mm": state.peg_relative_z_mm,
            "is_success": flags.is_success,
            "relative_motion_mm_deg": scene.relative_motion_mm_deg(),
            "gt_offset_mm_deg": state.offset.as_array(),
        }
        return {**info}
