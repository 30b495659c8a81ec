"""`Toy/Lift-v1`: lift a block off a table."""

from typing import Any, ClassVar

import numpy as np
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.tasks.ending import Flags, surface_moved_too_far
from vitac.envs.tasks.options import choice, numbers
from vitac.envs.tasks.task_env import Info, TactileTaskEnv

from .definition import TASK
from .scene import Block, LiftScene, LiftSettings, block_mesh, table_mesh

LIFTED_MM = 2.5


class LiftEnv(TactileTaskEnv[LiftScene, LiftSettings]):
    """Lift a block 2.5 mm off a table."""

    task: ClassVar = TASK
    settings_type: ClassVar = LiftSettings
    option_names: ClassVar[tuple[str, ...]] = ("shape", "place_mm")

    def _solids(self) -> list[SurfaceMesh]:
        return [*(block_mesh(shape) for shape in Block), table_mesh()]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> LiftScene:
        shape = choice(self.env_id, "shape", options.get("shape", Block.LOW), Block)
        place = options.get("place_mm", (random.uniform(-5.0, 5.0),))
        (x_mm,) = numbers(self.env_id, "place_mm", place, 1, "expected (x) in mm")
        return LiftScene(shape, x_mm, meshes=self._meshes, settings=self.settings, clocks=self._clocks)

    def _error(self) -> float:
        return max(0.0, LIFTED_MM - float(self.task_scene.heights_mm().min()))

    def _judge(self) -> Flags:
        scene = self.task_scene
        return Flags(
            tactile_movement_too_large=surface_moved_too_far(scene.grasped.surface_diff_m()),
            too_many_steps=scene.env_steps >= self.settings.max_steps,
            is_success=bool(scene.heights_mm().min() > LIFTED_MM),
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        return progress + (10.0 if flags.is_success else -1.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            "steps": scene.env_steps,
            "surface_diff_m": scene.grasped.surface_diff_m(),
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "height_mm": scene.heights_mm(),
            "is_success": flags.is_success,
        }
