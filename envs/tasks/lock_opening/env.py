"""`ViTac/LockOpening-v1`: align a key in its lock and lift it, holding it between two tactile sensors."""

from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...geometry.keys_and_locks import KeyShape
from ..ending import Flags
from ..task_env import Info, TactileTaskEnv
from .definition import TASK
from .info import LockInfo
from .meshes import key_mesh, lock_mesh
from .scene import LockScene
from .settings import TRAINING_RANGES, LockOpeningSettings
from .task import alignment_error, judge_flags, reward
from .variation import JITTER, OFFSET, SHAPE, choose_start


class LockOpeningEnv(TactileTaskEnv[LockScene, LockOpeningSettings]):
    """Pull a key outwards until its teeth stand below the slots of its lock, then lift it, by touch alone.

    The key starts up to 6.5 mm too deep in its lock, and the sensors grip its handle up to 2 mm off along the key and
    in height; the policy knows neither. World frame: z up, the lock's entrance towards +x. Actions outside -1 to 1
    are clipped (the 2025 code does not clip [D4]).

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("key1" to "key4"), `offset_mm` (x, y, z of the key from its deepest start),
    `sensor_jitter_mm` (x, z), and `rng_seed`, the integers that seed the episode's generator in place of the
    environment's own. What is left open is drawn: the key, x from 0 to 5 mm, and the jitter of up to 2 mm either way.

    Ends: terminated by success (`end_reason` "success"), even where a failure flag is raised with it; truncated by a
    sensing surface that moved more than 1.5 mm ("tactile"), a tooth far out of place ("error"), 50 env steps ("steps"),
    or physics that did not converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `LockOpeningSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = LockOpeningSettings
    shape_type: ClassVar = KeyShape
    training_ranges: ClassVar = TRAINING_RANGES
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, JITTER)

    def _solids(self) -> list[SurfaceMesh]:
        meshes, gap_mm = self._meshes, self.settings.slot_clearance_mm
        return [solid for shape in KeyShape for solid in (key_mesh(meshes, shape), lock_mesh(meshes, shape, gap_mm))]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> LockScene:
        settings = self.settings
        start = choose_start(
            options, random, shapes=self._shapes, x_mm=settings.random_x_mm, jitter_mm=settings.jitter_mm
        )
        drawn = self._settings_of_episode(random)
        return LockScene(start=start, meshes=self._meshes, settings=drawn, clocks=self._clocks)

    def _error(self) -> float:
        return alignment_error(self.task_scene.state())

    def _judge(self) -> Flags:
        return judge_flags(self.task_scene.state(), max_steps=self.settings.max_steps)

    def _reward(self, flags: Flags, progress: float) -> float:
        return reward(
            flags,
            self.scene.surface_diff_m(),
            progress=progress,
            step_penalty=self.settings.step_penalty,
            final_reward=self.settings.final_reward,
            failure_penalty=self.settings.failure_penalty,
        )

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        state = scene.state()
        info: LockInfo = {
            "steps": state.env_steps,
            "key1_pts_m": state.rear_tooth_m,
            "key2_pts_m": state.front_tooth_m,
            "key_side_pts_m": scene.tip_m(),
            "lock1_pts_m": state.rear_slot_m,
            "lock2_pts_m": state.front_slot_m,
            "lock_side_pts_m": state.entrance_m,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "relative_motion_mm": scene.relative_motion_mm(),
            "error_too_large": flags.error_too_large,
            "is_success": flags.is_success,
        }
        return {**info}
