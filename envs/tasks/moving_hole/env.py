"""`ViTac/MovingHole-v1`: insert a peg into the hole of a plate that moves."""

from collections.abc import Mapping
from math import inf
from typing import Any, ClassVar

import numpy as np

from ...scene.perspective import ActionArray, longest_action
from ..definition import Flags
from ..insertion.env import way_to_the_hole
from ..peg_insertion.env import OFFSET, PegInsertionEnv
from ..settings import SHAPE, choice, either_way, numbers
from ..task_env import Info, Observation
from .definition import TASK
from .scene import EARLIEST_START_S, MovingHoleScene, MovingHoleSettings, MovingHoleStart, PlateMotion, PlatePath

MOTION, DIRECTION, START = "plate_motion", "plate_direction_deg", "plate_start_s"


class MovingHoleEnv(PegInsertionEnv):
    """Insert a peg into the hole of a plate that begins to move, by touch alone.

    As `ViTac/PegInsertion-v1`, but some time after the reset the plate begins to move: at a constant speed, to and fro,
    or as a conveyor that runs and stops. The policy observes neither that time nor the direction. The plate drags at
    the peg that is pressed on it. Every env step takes the same time, 0.4 s, in which the gripper moves in the world as
    the action says and 0.08 mm down, all together. Contacts are those of `arena-2`.

    Reset options: `shape`, `offset_mm_deg` and `rng_seed` as there, `plate_motion` ("constant", "sine", "conveyor"),
    `plate_direction_deg` (from x towards y), and `plate_start_s`, of which 0.4 is the reset's end. What is left open
    is drawn.

    Ends: as there, after 12 env steps; the offset that may not be beyond 12 mm is that from the hole where it is.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `MovingHoleSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = MovingHoleSettings
    scene_type: ClassVar = MovingHoleScene
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, MOTION, DIRECTION, START)

    def choose_start(self, options: Mapping[str, Any], random: np.random.Generator, settings: Any) -> MovingHoleStart:
        """Return the start that the options give; what they leave open is drawn: first the peg's, then the path."""
        start = super().choose_start(options, random, settings)
        path = self._choose_path(options, random, settings)
        return MovingHoleStart(shape=start.shape, offset=start.offset, path=path)

    def _choose_path(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: MovingHoleSettings
    ) -> PlatePath:
        """Return the path that the options give; what they leave open is drawn: motion, direction and start."""
        kind, turn, late = int(random.integers(len(PlateMotion))), random.random(), random.random()
        given = options.get(MOTION)
        motion = list(PlateMotion)[kind] if given is None else choice(self.env_id, MOTION, given, PlateMotion)
        drawn = {DIRECTION: 360.0 * turn, START: EARLIEST_START_S + settings.latest_start_s * late}
        direction_deg, start_s = (
            numbers(self.env_id, name, [options.get(name, value)], either_way(inf), "expected a number")[0]
            for name, value in drawn.items()
        )
        speed_mm_s = settings.plate_speed_mm_s
        return PlatePath(motion=motion, speed_mm_s=speed_mm_s, direction_deg=direction_deg, start_s=start_s)

    def _info(self, flags: Flags) -> Info:
        scene: Any = self.task_scene
        shift_mm = 1e3 * scene.grasped.fixed_shift_m()[:2]
        return {**super()._info(flags), "plate_mm": shift_mm, "plate_step_mm": scene.plate_step_mm()}


def to_where_the_hole_will_be(_: Observation, info: Info) -> ActionArray:
    """Take the offset away that is left if the gripper rests while the plate moves."""
    offset_mm_deg = info["gt_offset_mm_deg"].copy()
    offset_mm_deg[:2] -= info["plate_step_mm"]
    return longest_action(np.array(way_to_the_hole(offset_mm_deg.tolist())), np.array(TASK.action_scale))
