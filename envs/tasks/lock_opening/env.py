"""`ViTac/LockOpening-v1`: align a key in its lock and lift it, holding it between two tactile sensors."""

from collections.abc import Mapping
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import NDArray

from ...fem.model.mesh import SurfaceMesh
from ...geometry.keys_and_locks import KeyShape
from ...scene.perspective import ActionArray, longest_action
from ..definition import Flags
from ..settings import SHAPE, choose_shape, either_way, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import SUCCESS_Z_RANGE_M, TASK, alignment_error, judge_flags, reward
from .scene import (
    TRAINING_RANGES,
    KeyOffset,
    LockOpeningSettings,
    LockScene,
    LockStart,
    SensorJitter,
    key_mesh,
    lock_mesh,
)

OFFSET, JITTER = "offset_mm", "sensor_jitter_mm"


# A start at which the key's tip is clear of the end wall and its shaft and teeth of floor, ceiling and walls.
X_RANGE_MM = (-1.4, 40.0)
LARGEST_Y_MM = 0.8
LARGEST_Z_MM = 0.8
LARGEST_JITTER_MM = 4.0


FloatArray = NDArray[np.float64]


class LockInfo(TypedDict):
    """The challenge's entries, in the order of its logs; the base adds how the episode ended.

    Points are in the world [m], each of shape [4, 3].

    Attributes:
        steps: env steps played so far.
        key1_pts_m: top corners of the key's rear measured tooth.
        key2_pts_m: top corners of the front measured tooth.
        key_side_pts_m: corners of the key's tip.
        lock1_pts_m: lower corners of the slot for the rear tooth.
        lock2_pts_m: lower corners of the slot for the front tooth.
        lock_side_pts_m: corners of the lock's entrance face.
        surface_diff_m: mean motion of the left and the right sensing surface since the grasp [m], shape [2].
        tactile_movement_too_large: one of them is more than the task allows.
        relative_motion_mm: motion of the gripper (x, y, z) since the reset [mm], shape [3].
        error_too_large: a tooth is far out of place.
        is_success: the task is solved.
    """

    steps: int
    key1_pts_m: FloatArray
    key2_pts_m: FloatArray
    key_side_pts_m: FloatArray
    lock1_pts_m: FloatArray
    lock2_pts_m: FloatArray
    lock_side_pts_m: FloatArray
    surface_diff_m: FloatArray
    tactile_movement_too_large: bool
    relative_motion_mm: FloatArray
    error_too_large: bool
    is_success: bool


class LockOpeningEnv(TactileTaskEnv[LockScene, LockOpeningSettings]):
    """Pull a key outwards until its teeth stand below the slots of its lock, then lift it, by touch alone.

    The key starts up to 6.5 mm too deep in its lock, and the sensors grip its handle up to 2 mm off along the key and
    in height; the policy knows neither. World frame: z up, the lock's entrance towards +x. Actions outside -1 to 1
    are clipped (the 2025 code does not clip).

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
    scene_type: ClassVar = LockScene
    shape_type: ClassVar = KeyShape
    training_ranges: ClassVar = TRAINING_RANGES
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, JITTER)

    def _solids(self) -> list[SurfaceMesh]:
        meshes, gap_mm = self._meshes, self.settings.slot_clearance_mm
        return [solid for shape in KeyShape for solid in (key_mesh(meshes, shape), lock_mesh(meshes, shape, gap_mm))]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: LockOpeningSettings
    ) -> LockStart:
        """Return the start that the options give, or draw it: key, x, then size and sign of each jitter."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            offset = KeyOffset(x_mm=settings.random_x_mm * random.random(), y_mm=0.0, z_mm=0.0)
        else:
            offset = self._read_offset(wanted)
        jitter = options.get(JITTER)
        if jitter is None:
            jitter = [_random_sided(random, largest_mm) for largest_mm in self._largest_jitter_mm(settings)]
        expected = f"expected (x, z) in mm within {LARGEST_JITTER_MM:g} either way"
        ranges = either_way(LARGEST_JITTER_MM, LARGEST_JITTER_MM)
        x_mm, z_mm = numbers(self.env_id, JITTER, jitter, ranges, expected)
        return LockStart(shape=shape, offset=offset, jitter=SensorJitter(x_mm=x_mm, z_mm=z_mm))

    def _read_offset(self, value: Any) -> KeyOffset:
        """Return the offset that the option gives, if the key is clear of its lock there."""
        low, high = X_RANGE_MM
        expected = (
            f"expected (x, y, z) in mm with {low:g} <= x <= {high:g}, |y| <= {LARGEST_Y_MM:g}, |z| <= {LARGEST_Z_MM:g}"
        )
        ranges = (X_RANGE_MM, *either_way(LARGEST_Y_MM, LARGEST_Z_MM))
        x_mm, y_mm, z_mm = numbers(self.env_id, OFFSET, value, ranges, expected)
        return KeyOffset(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)

    def _largest_jitter_mm(self, settings: LockOpeningSettings) -> tuple[float, float]:
        """Return the largest drawn jitter along the key, and in height."""
        return settings.jitter_mm, settings.jitter_mm

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


def _random_sided(random: np.random.Generator, largest: float) -> float:
    """Return a size from 0 to the largest, then a sign."""
    size = largest * random.random()
    return size if random.integers(2) else -size


# Above the least height at which the lock opens [mm].
_LIFT_MARGIN_MM = 0.5


def out_and_up(_: Observation, info: Info) -> ActionArray:
    """Go out until the rear tooth is below its slot, and up into it, at once: the teeth rub along the ceiling."""
    tooth_m, slot_m = info["key1_pts_m"], info["lock1_pts_m"]
    inwards_mm = 1e3 * (tooth_m[:, 0].mean() - slot_m[:, 0].mean())
    down_mm = 1e3 * (tooth_m[:, 2].min() - SUCCESS_Z_RANGE_M[0]) - _LIFT_MARGIN_MM
    return longest_action(np.array([inwards_mm, down_mm]), np.array(TASK.action_scale))
