"""`ViTac/PegInsertion-v1`: insert a peg that is held between two tactile sensors."""

from collections.abc import Mapping
from math import radians
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import PegShape
from ..settings import settings_from
from ..task_env import FloatArray, Info, TactileTaskEnv, Verdict
from .scene import PegScene
from .settings import PegInsertionSettings
from .task import PegState, judge_flags, reward
from .variation import ENV_ID, OFFSET, SHAPE, PegOffset, choose_start


class PegInsertionEnv(TactileTaskEnv[PegScene, PegInsertionSettings]):
    """Insert a peg into the hole of a plate, by touch alone.

    The peg hangs between two gels, displaced from its hole by a few millimetres and degrees that the policy is not
    told. Every env step moves the gripper as the action says, then 0.125 mm down. World frame: z up, origin at the
    hole's centre in the plate's lower face.

    Action space: `Box(-1, 1, (3,), float32)`; values outside are clipped.

    | index | name | at 1 | meaning |
    |---|---|---|---|
    | 0 | x | 2 mm | along the gripper's own x axis, as it stands before the env step |
    | 1 | y | 2 mm | along the gripper's own y axis, the grasping direction |
    | 2 | theta | 4 deg | about the vertical, counter-clockwise seen from above |

    Observation space: `Dict`

    | key | shape | type | unit | meaning |
    |---|---|---|---|---|
    | gt_offset | (3,) | float32 | mm, mm, deg | commanded offset from the hole; **only with `privileged=True`** |
    | relative_motion | (4,) | float32 | mm, mm, deg, mm | commanded motion (x, y, theta, z) since the reset |
    | marker_flow | (2, 2, 128, 2) | float32 | pixel | [sensor left, right][reference, current][marker][u, v] |

    The reference of `marker_flow` is the surface after the grasp. Its grid is drawn anew at every observation; 56 to
    80 markers are seen, and the last is repeated.

    Reset options: `shape` ("cuboid", "trapezoid", "concave1"), `offset_mm_deg` (x, y, theta), and `rng_seed`, the
    integers that seed the episode's generator in place of the environment's own. What is left open is drawn: the
    shape, and an offset within 5 mm and 10 degrees at which the peg is really blocked.

    Ends: terminated by success (`end_reason` "success"); truncated by a sensing surface that moved more than 1.5 mm
    ("tactile"), an offset beyond 12 mm or 15 degrees ("error"), 8 env steps ("steps"), or physics that did not converge
    ("not_converged", after which nothing moves). An end that already came in the reset is in the info of the reset.

    Args:
        privileged: add the commanded offset to the observation, for training.
        assets_dir: folder with the challenge's own meshes, to be used in place of the generated ones.
        **overrides: fields of `PegInsertionSettings`.
    """

    env_id: ClassVar[str] = ENV_ID
    action_names: ClassVar[tuple[str, ...]] = ("dx_mm", "dy_mm", "dtheta_deg")
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)
    motion_size: ClassVar[int] = 4
    privileged_shapes: ClassVar[Mapping[str, tuple[int, ...]]] = {"gt_offset": (3,)}

    def __init__(self, *, privileged: bool = False, assets_dir: str | Path | None = None, **overrides: Any) -> None:
        settings = settings_from(PegInsertionSettings, overrides)
        super().__init__(settings=settings, privileged=privileged, assets_dir=assets_dir)
        self._initial = self._offset = PegOffset(x_mm=0.0, y_mm=0.0, theta_deg=0.0)

    def _solids(self) -> list[SurfaceMesh]:
        return [solid for shape in PegShape for solid in (self._meshes.peg(shape), self._meshes.hole(shape))]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> PegScene:
        settings = self.settings
        start = choose_start(options, random, xy_mm=settings.random_xy_mm, theta_deg=settings.random_theta_deg)
        self._initial = self._offset = start.offset
        return PegScene(start=start, meshes=self._meshes, settings=settings, clocks=self._clocks)

    def _error(self) -> float:
        return self._offset.magnitude()

    def _move(self, command: FloatArray) -> None:
        before = self._offset
        self._offset = self._commanded(command)
        self.task_scene.travel(before, self._offset)

    def _commanded(self, command: FloatArray) -> PegOffset:
        """Books after an action: scaled, clipped, and x and y turned by the angle before the env step."""
        scale = np.array(self.settings.action_scale_mm_deg)
        dx, dy, dtheta = np.clip(command * scale, -scale, scale).tolist()
        sine, cosine = sine_cosine(radians(self._offset.theta_deg))
        return PegOffset(
            x_mm=self._offset.x_mm + (dx * cosine - dy * sine),
            y_mm=self._offset.y_mm + (dx * sine + dy * cosine),
            theta_deg=self._offset.theta_deg + dtheta,
        )

    def _judge(self, progress: float) -> Verdict:
        settings = self.settings
        state = self._state()
        flags = judge_flags(state, max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)
        gained = reward(
            flags,
            progress=progress,
            env_steps=self._env_steps,
            max_steps=settings.max_steps,
            step_penalty=settings.step_penalty,
            final_reward=settings.final_reward,
        )
        success = flags.is_success and self.scene.solved
        info = self._info(
            state,
            tactile_movement_too_large=flags.tactile_movement_too_large,
            too_many_steps=flags.too_many_steps,
            error_too_large=flags.error_too_large,
            is_success=success,
        )
        return Verdict(success=success, failure=flags.failure, reward=gained, info=info)

    def _reset_info(self) -> Info:
        return self._info(
            self._state(),
            tactile_movement_too_large=False,
            too_many_steps=False,
            error_too_large=False,
            is_success=False,
        )

    def _state(self) -> PegState:
        return PegState(
            env_steps=self._env_steps,
            offset=self._offset,
            surface_diff_m=self.scene.surface_diff_m(),
            peg_relative_z_mm=self.task_scene.peg_relative_z_mm(),
        )

    def _info(
        self,
        state: PegState,
        *,
        tactile_movement_too_large: bool,
        too_many_steps: bool,
        error_too_large: bool,
        is_success: bool,
    ) -> Info:
        return {
            "steps": state.env_steps,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": tactile_movement_too_large,
            "too_many_steps": too_many_steps,
            "error_too_large": error_too_large,
            "peg_relative_z_mm": state.peg_relative_z_mm,
            "is_success": is_success,
            "relative_motion_mm_deg": self._relative_motion(),
            "gt_offset_mm_deg": self._offset_array(),
        }

    def _privileged_observation(self) -> Mapping[str, FloatArray]:
        return {"gt_offset": self._offset_array()}

    def _relative_motion(self) -> FloatArray:
        """Commanded x, y, theta, z since the reset [mm, mm, deg, mm]; the descent of the reset is not counted."""
        now, initial = self._offset, self._initial
        descent_mm = -self._env_steps * self.settings.z_step_mm
        return np.array(
            [now.x_mm - initial.x_mm, now.y_mm - initial.y_mm, now.theta_deg - initial.theta_deg, descent_mm]
        )

    def _offset_array(self) -> FloatArray:
        return np.array([self._offset.x_mm, self._offset.y_mm, self._offset.theta_deg])
