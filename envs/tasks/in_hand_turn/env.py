"""`ViTac/InHandTurn-v1`: turn a rod between the gels that hold it, by pressing it against an edge."""

from collections.abc import Mapping
from math import radians
from typing import Any, ClassVar

import numpy as np

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import SurfaceMesh
from ...scene.perspective import ActionArray
from ..definition import Flags
from ..settings import SHAPE, choose_shape, numbers
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import TASK
from .scene import InHandTurnScene, InHandTurnSettings, RodShape, TurnStart, edge_mesh, rod_mesh

START = "start_mm_deg"
# Gap [mm], angle and goal [deg]: what may be asked for, and what is drawn.
USABLE = ((0.2, 30.0), (-15.0, 15.0), (-45.0, 45.0))
DRAWN = ((0.5, 16.5), (-8.0, 6.0), (14.0, 32.0))


class InHandTurnEnv(TactileTaskEnv[InHandTurnScene, InHandTurnSettings]):
    """Turn a rod between the gels that hold it to a given angle, by pressing it against an edge, by touch alone.

    The rod hangs in the grasp beside the edge of a bar, at an unknown distance from it and an unknown angle. Pressed
    against the edge it twists the gels and then slides between them; what it has twisted them by it turns back when it
    is freed. The policy observes to which angle, not which one it has. World frame: z up, the edge along y through the
    origin, its bar towards +x. Actions outside -1 to 1 are clipped. Contacts are those of `arena-2`.

    An episode has 14 env steps. After the last one, or when it has failed, the gripper withdraws by 12 mm, within that
    env step, and the angle of the free rod counts. What ends otherwise counts as if the rod had not been turned.

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("narrow", "wide"), `start_mm_deg` (gap between edge and rod, angle of the rod, goal), and
    `rng_seed`, the integers that seed the episode's generator in place of the environment's own. What is left open is
    drawn: the shape, a gap of 0.5 to 16.5 mm, an angle of -8 to 6 degrees, and a goal of 14 to 32 degrees.

    Ends: terminated after 14 env steps with an error of at most 0.5 degrees (`end_reason` "success"); truncated by a
    sensing surface that moved more than 1.5 mm ("tactile"), a gripper more than 8 mm above or below where it started or
    a rod at more than 75 degrees ("error"), 14 env steps ("steps"), or physics that did not converge ("not_converged",
    after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `InHandTurnSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = InHandTurnSettings
    scene_type: ClassVar = InHandTurnScene
    shape_type: ClassVar = RodShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, START)

    def _solids(self) -> list[SurfaceMesh]:
        return [*map(rod_mesh, RodShape), edge_mesh()]

    def choose_start(
        self,
        options: Mapping[str, Any],
        random: np.random.Generator,
        settings: InHandTurnSettings,  # noqa: ARG002 - as of all tasks
    ) -> TurnStart:
        """Return the start that the options give; what they leave open is drawn: shape, then gap, angle and goal."""
        shape = choose_shape(self.env_id, options, self._shapes, random)
        drawn = [low + (high - low) * random.random() for low, high in DRAWN]
        ranges = [f"{low:g} to {high:g}" for low, high in USABLE]
        expected = f"expected (gap mm, angle deg, goal deg) of {', '.join(ranges)}"
        gap_mm, angle_deg, goal_deg = numbers(self.env_id, START, options.get(START, drawn), USABLE, expected)
        return TurnStart(shape=shape, gap_mm=gap_mm, angle_deg=angle_deg, goal_deg=goal_deg)

    def _error(self) -> float:
        scene = self.task_scene
        return abs(scene.goal_deg - scene.angle_deg())

    def _judge(self) -> Flags:
        scene, settings = self.task_scene, self.settings
        failed = scene.moved_too_far or scene.has_left_range
        ended = scene.env_steps >= settings.max_steps
        reached = ended and not failed and scene.free_error_deg() <= settings.tolerance_deg
        return Flags(
            tactile_movement_too_large=scene.moved_too_far,
            error_too_large=scene.has_left_range,
            too_many_steps=ended and not reached,
            is_success=reached,
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        return progress + (self.settings.final_reward if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "angle_deg": scene.angle_deg(),
            "goal_deg": scene.goal_deg,
            "angle_error_deg": scene.free_error_deg(),
            "twist_deg": scene.twist_deg(),
            "gap_mm": scene.gap_mm(),
            "edge_mm": scene.edge_mm(),
            "relative_motion_mm": scene.relative_motion_mm(),
            "is_success": flags.is_success,
        }


# Part of the twist of the gels by which a rod turns back.
_RETURNED = 0.92
# Part of the way that is gone at once: what has been turned too far cannot be turned back.
_CAUTION = 0.6


def press_until_it_stays(_: Observation, info: Info) -> ActionArray:
    """Press the rod against the edge until it would turn back to its goal, and wait there."""
    cosine = sine_cosine(radians(info["angle_deg"]))[1]
    left_rad = radians(info["goal_deg"] + _RETURNED * info["twist_deg"] - info["angle_deg"])
    way_mm = info["gap_mm"] - info["edge_mm"][1] * left_rad / (cosine * cosine)
    return np.array([np.clip(_CAUTION * way_mm / TASK.action_scale[0], 0.0, 1.0), 0.0], dtype=np.float32)
