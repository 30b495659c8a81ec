"""`ViTac/LockOpening-v1`: align a key in its lock and lift it, holding it between two tactile sensors."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...geometry.keys import KeyShape
from ..settings import settings_from
from ..task_env import FloatArray, Info, TactileTaskEnv, Verdict
from .scene import SENSOR_X_MM, LockScene
from .settings import LockOpeningSettings
from .task import CEILING_Z_M, LockState, alignment_error, judge_flags, reward
from .variation import ENV_ID, JITTER, OFFSET, SHAPE, choose_start

# Where the 2025 code records the grasp to be on every key, instead of at the sensors [mm from the tip].
_RECORDED_GRASP_X_MM = 49.5
_POINT_SCALE_PER_M = 200.0


class LockOpeningEnv(TactileTaskEnv[LockScene, LockOpeningSettings]):
    """Pull a key outwards until its teeth stand below the slots of its lock, then lift it, by touch alone.

    The key starts up to 6.5 mm too deep in its lock, and the sensors grip its handle up to 2 mm off along the key and
    in height; the policy is told neither. World frame: z up, the lock's entrance towards +x.

    Action space: `Box(-1, 1, (2,), float32)`; values outside are clipped (the 2025 code does not clip [D4]).

    | index | name | at 1 | meaning |
    |---|---|---|---|
    | 0 | x | 2 mm | into the lock, along -x; negative pulls outwards |
    | 1 | z | 1 mm | down; negative lifts |

    Observation space: `Dict`

    | key | shape | type | unit | meaning |
    |---|---|---|---|---|
    | key_side_pts | (4, 3) | float32 | m | corners of the key's tip; **to key2 only with `privileged=True`** |
    | lock1_pts | (4, 3) | float32 | m | lower corners of the slot for the key's rear tooth |
    | lock2_pts | (4, 3) | float32 | m | lower corners of the slot for the front tooth |
    | lock_side_pts | (4, 3) | float32 | m | corners of the lock's entrance face |
    | key1 | (3,) | float32 | 5 mm | rear tooth from its slot: x, y, and height above the ceiling |
    | key2 | (3,) | float32 | 5 mm | front tooth from its slot |
    | relative_motion | (3,) | float32 | mm | motion of the gripper (x, y, z) since the reset |
    | marker_flow | (2, 2, 128, 2) | float32 | pixel | [sensor left, right][reference, current][marker][u, v] |

    The reference of `marker_flow` is the surface after the grasp. Its grid is drawn anew at every observation; 56 to
    80 markers are seen, and the last is repeated. Left is the sensor at -y.

    Reset options: `shape` ("key1" to "key4"), `offset_mm` (x, y, z of the key from its deepest start),
    `sensor_jitter_mm` (x, z), and `rng_seed`, the integers that seed the episode's generator in place of the
    environment's own. What is left open is drawn: the key, x from 0 to 5 mm, and the jitter of up to 2 mm either way.

    Ends: terminated by success (`end_reason` "success"), even where a failure flag comes with it; truncated by a
    sensing surface that moved more than 1.5 mm ("tactile"), a tooth far out of place ("error"), 50 env steps ("steps"),
    or physics that did not converge ("not_converged", after which nothing moves).

    Args:
        privileged: add the privileged entries to the observation, for training.
        assets_dir: folder with the challenge's own meshes, to be used in place of the generated ones.
        **overrides: fields of `LockOpeningSettings`.
    """

    env_id: ClassVar[str] = ENV_ID
    action_names: ClassVar[tuple[str, ...]] = ("in_mm", "down_mm")
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, JITTER)
    motion_size: ClassVar[int] = 3
    privileged_shapes: ClassVar[Mapping[str, tuple[int, ...]]] = {
        **dict.fromkeys(("key_side_pts", "lock1_pts", "lock2_pts", "lock_side_pts"), (4, 3)),
        **dict.fromkeys(("key1", "key2"), (3,)),
    }

    def __init__(self, *, privileged: bool = False, assets_dir: str | Path | None = None, **overrides: Any) -> None:
        settings = settings_from(LockOpeningSettings, overrides)
        super().__init__(settings=settings, privileged=privileged, assets_dir=assets_dir)
        self._shape = KeyShape.KEY1

    def _solids(self) -> list[SurfaceMesh]:
        return [solid for shape in KeyShape for solid in (self._meshes.key(shape), self._meshes.lock(shape))]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> LockScene:
        settings = self.settings
        start = choose_start(options, random, x_mm=settings.random_x_mm, jitter_mm=settings.jitter_mm)
        self._shape = start.shape
        return LockScene(start=start, meshes=self._meshes, settings=settings, clocks=self._clocks)

    def _error(self) -> float:
        return alignment_error(self._state())

    def _move(self, command: FloatArray) -> None:
        inwards_mm, down_mm = (np.clip(command, -1.0, 1.0) * np.array(self.settings.action_scale_mm)).tolist()
        self.task_scene.travel(-inwards_mm, -down_mm)

    def _judge(self, progress: float) -> Verdict:
        settings = self.settings
        state = self._state()
        flags = judge_flags(state, max_steps=settings.max_steps)
        gained = reward(
            flags,
            state.surface_diff_m,
            progress=progress,
            step_penalty=settings.step_penalty,
            final_reward=settings.final_reward,
            failure_penalty=settings.failure_penalty,
        )
        success = flags.is_success and self.scene.solved
        info = self._info(
            state,
            tactile_movement_too_large=flags.tactile_movement_too_large,
            error_too_large=flags.error_too_large,
            is_success=success,
        )
        return Verdict(success=success, failure=flags.failure, reward=gained, info=info)

    def _reset_info(self) -> Info:
        return self._info(self._state(), tactile_movement_too_large=False, error_too_large=False, is_success=False)

    def _state(self) -> LockState:
        return self.task_scene.state(self._env_steps)

    def _info(
        self, state: LockState, *, tactile_movement_too_large: bool, error_too_large: bool, is_success: bool
    ) -> Info:
        return {
            "steps": state.env_steps,
            "key1_pts_m": state.rear_tooth_m,
            "key2_pts_m": state.front_tooth_m,
            "key_side_pts_m": self.task_scene.tip_m(),
            "lock1_pts_m": state.rear_slot_m,
            "lock2_pts_m": state.front_slot_m,
            "lock_side_pts_m": state.entrance_m,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": tactile_movement_too_large,
            "relative_motion_mm": self._relative_motion(),
            "error_too_large": error_too_large,
            "is_success": is_success,
        }

    def _privileged_observation(self) -> Mapping[str, FloatArray]:
        state = self._state()
        return {
            "key_side_pts": self.task_scene.tip_m(),
            "lock1_pts": state.rear_slot_m,
            "lock2_pts": state.front_slot_m,
            "lock_side_pts": state.entrance_m,
            "key1": _tooth_from_slot(state.rear_tooth_m, state.rear_slot_m),
            "key2": _tooth_from_slot(state.front_tooth_m, state.front_slot_m),
        }

    def _relative_motion(self) -> FloatArray:
        """Motion of the gripper's centre since the reset [mm], shape [3].

        The 2025 code measures from a wrong grasp centre after the first env step, so that x jumps by 20.5, 25.5, 20.5
        or 30.5 mm and gives the key away (challenge-facts 14.2); only `reference_quirks` does so here.
        """
        motion_mm = self.task_scene.relative_motion_mm()
        if self.settings.reference_quirks and self._env_steps > 0:
            motion_mm[0] += SENSOR_X_MM[self._shape] - _RECORDED_GRASP_X_MM
        return motion_mm


def _tooth_from_slot(tooth_m: FloatArray, slot_m: FloatArray) -> FloatArray:
    """Mean tooth corner relative to its slot: x from the slot's middle, y, z from the ceiling, times 200 per metre."""
    tooth = tooth_m.sum(axis=0) / len(tooth_m)
    slot_x_m = slot_m[:, 0].sum() / len(slot_m)
    return np.asarray(_POINT_SCALE_PER_M * (tooth - np.array([slot_x_m, 0.0, CEILING_Z_M])))
