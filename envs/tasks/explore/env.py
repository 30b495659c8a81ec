"""`ViTac/Explore-v1`: find by touch which of six ends a held block has."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...scene.perspective import ActionArray
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, choice, choose_shape, either_way, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import REACH_MM, TASK, EndShape
from .scene import EndPose, ExploreScene, ExploreSettings, ExploreStart, block_mesh, pin_mesh

END_POSE = "end_pose_mm_deg"
LARGEST_MM_DEG = (3.0, 3.0, 30.0)
AROUND_MM = ((6.5, 0.0), (6.5, 6.5), (0.0, 6.5), (-6.5, 0.0), (0.0, -6.5))
"""Where the touches of `touch_around` are after the first, from the pin."""


class ExploreEnv(TactileTaskEnv[ExploreScene, ExploreSettings]):
    """Find by touch which of six ends a held block has, and say how certain you are.

    A block hangs between two gels above a pin of 3 mm. Below it is an end, 10 mm high: a square, a bar, a bar across,
    a cross, a frame or a corner, not quite in the middle of the block and not quite straight, which the policy is not
    told. Every env step lifts the block, moves it as the action says, and brings it down on the pin by 0.3 mm more than
    the gap. Where the end is above the pin, the gels feel it; where it is not, nothing touches. The reset makes the
    first touch, with the middle of the block. Actions outside -1 to 1 are clipped.

    World frame: z up, origin below the pin. Contacts are those of `arena-2`.

    The last six numbers of an action are the answer so far. That of the last env step counts: its Brier score is the
    squared distance of the confidences from the truth.

    Reset options: `shape` ("square", "bar", "beam", "cross", "frame", "corner"), `end_pose_mm_deg` (x, y, angle of the
    end on the block), and `rng_seed`. What is left open is drawn.

    Ends: after 6 env steps, terminated with success if the answer is most confident of the true shape, else truncated
    ("steps"); truncated before by a sensing surface that moved more than 1.5 mm ("tactile"), by a gripper more than
    16 mm from the pin ("error"), or by physics that did not converge ("not_converged").

    Keyword arguments: those of `TactileTaskEnv`, and fields of `ExploreSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = ExploreSettings
    scene_type: ClassVar = ExploreScene
    shape_type: ClassVar = EndShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, END_POSE)

    def _solids(self) -> list[SurfaceMesh]:
        straight = EndPose(x_mm=0.0, y_mm=0.0, angle_deg=0.0)
        return [*(block_mesh(shape, straight) for shape in EndShape), pin_mesh()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: ExploreSettings
    ) -> ExploreStart:
        """Return the start that the options give; all is drawn also where they do."""
        drawn_one, given = choose_shape(self.env_id, {}, self._shapes, random), options.get(SHAPE)
        shape = drawn_one if given is None else choice(self.env_id, SHAPE, given, EndShape)
        x, y, angle = random.uniform(-1.0, 1.0, 3).tolist()
        xy_mm = settings.random_xy_mm
        drawn = (x * xy_mm, y * xy_mm, angle * settings.random_angle_deg)
        wanted = options.get(END_POSE, drawn)
        xy_largest_mm, _, largest_deg = LARGEST_MM_DEG
        expected = (
            f"expected (x mm, y mm, angle deg) within {xy_largest_mm:g} mm and {largest_deg:g} degrees either way"
        )
        x_mm, y_mm, angle_deg = numbers(self.env_id, END_POSE, wanted, either_way(*LARGEST_MM_DEG), expected)
        return ExploreStart(shape=shape, end=EndPose(x_mm=x_mm, y_mm=y_mm, angle_deg=angle_deg))

    def _error(self) -> float:
        return self.task_scene.brier_score()

    def _judge(self) -> Flags:
        scene = self.task_scene
        is_over = scene.env_steps >= self.settings.max_steps
        has_moved, has_left = surface_moved_too_far(scene.grasped.surface_diff_m()), scene.has_left_range()
        is_success = is_over and scene.is_right() and not (has_moved or has_left)
        return Flags(
            tactile_movement_too_large=has_moved,
            error_too_large=has_left,
            too_many_steps=is_over and not is_success,
            is_success=is_success,
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        return progress + (1.0 if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "relative_motion_mm": scene.position_mm(),
            "confidences": scene.confidences,
            "brier_score": scene.brier_score(),
            "is_success": flags.is_success,
            "shape_number": list(EndShape).index(scene.shape),
        }


def touch_around(_: Observation, info: Info) -> ActionArray:
    """Touch five places around the middle, and answer with the truth: who imitates it learns how certain one can be."""
    place_mm = np.array(AROUND_MM[min(info["steps"], len(AROUND_MM) - 1)])
    action = np.full(2 + len(EndShape), -1.0)
    action[:2] = np.clip((place_mm - info["relative_motion_mm"]) / REACH_MM, -1.0, 1.0)
    action[2 + info["shape_number"]] = 1.0
    return action.astype(np.float32)
