"""`Switch/Press-v1`: press a switch until it closes."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.tasks.definition import Flags, surface_moved_too_far
from vitac.envs.tasks.settings import choose_shape, numbers
from vitac.envs.tasks.task_env import Info, TactileTaskEnv

from .definition import CLOSES_AT_N, TASK
from .scene import Button, SwitchScene, SwitchSettings, SwitchStart, button_mesh, finger_mesh, housing_mesh

LOWEST_MM, HIGHEST_MM = 1.0, 5.0


class SwitchEnv(TactileTaskEnv[SwitchScene, SwitchSettings]):
    """Press a button of unknown height until the force on it closes the switch, and not much harder."""

    task: ClassVar = TASK
    settings_type: ClassVar = SwitchSettings
    shape_type: ClassVar = Button
    scene_type: ClassVar = SwitchScene
    option_names: ClassVar[tuple[str, ...]] = ("shape", "height_mm")

    def _solids(self) -> list[SurfaceMesh]:
        return [finger_mesh(), housing_mesh(), *(button_mesh(shape, HIGHEST_MM) for shape in Button)]

    def choose_start(
        self,
        options: Mapping[str, Any],
        random: np.random.Generator,
        settings: SwitchSettings,
    ) -> SwitchStart:
        """Return the start that the options give; what they leave open is drawn: shape, then height."""
        shape = choose_shape(self.env_id, options, self._shapes, random)
        wanted = options.get("height_mm", (random.uniform(LOWEST_MM, HIGHEST_MM),))
        expected = f"expected (height) of {LOWEST_MM:g} to {HIGHEST_MM:g} mm"
        (height_mm,) = numbers(self.env_id, "height_mm", wanted, [(LOWEST_MM, HIGHEST_MM)], expected)
        return SwitchStart(shape=shape, height_mm=height_mm)

    def _error(self) -> float:
        scene = self.task_scene
        missing_n = max(0.0, CLOSES_AT_N - scene.button_force_n())
        return max(0.0, float(scene.gap_mm().min())) + missing_n / CLOSES_AT_N

    def _judge(self) -> Flags:
        scene = self.task_scene
        return Flags(
            tactile_movement_too_large=surface_moved_too_far(scene.grasped.surface_diff_m()),
            too_many_steps=scene.env_steps >= self.settings.max_steps,
            is_success=scene.button_force_n() >= CLOSES_AT_N,
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        return progress + (10.0 if flags.is_success else -0.1)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            "steps": scene.env_steps,
            "surface_diff_m": scene.grasped.surface_diff_m(),
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "gap_mm": scene.gap_mm(),
            "button_force_n": scene.button_force_n(),
            "is_success": flags.is_success,
        }
