"""`ViTac/FusionInsertion-v1`: see which hole fits the peg, go there, and insert it by touch."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import NDArray

from ...fem.model.mesh import SurfaceMesh
from ...geometry.bases import (
    HEXAGON_HOLE_Y_MM,
    RIM_MM,
)
from ...scene.perspective import ActionArray, longest_action
from ...vision.observables import OBJECT_POINT_CLOUD
from ...vision.pinhole import NOMINAL, RigShift
from ..definition import Flags
from ..insertion.env import InsertionEnv, way_to_the_hole
from ..insertion.interface import is_beyond
from ..insertion.scene import InsertionState, compute_flags, training_ranges
from ..quantities import drawn_settings
from ..settings import SHAPE, choice, either_way, numbers, refusal
from ..task_env import Info, Observation
from .definition import TASK
from .scene import (
    Z_TARGET_MM,
    FusionInsertionSettings,
    FusionOffset,
    FusionScene,
    FusionShape,
    FusionStart,
    RigVariation,
    Target,
    base_mesh,
    peg_mesh,
)

START = "start"


# The task's own limits of the commanded offset; z is measured from the rim's height.
LARGEST_X_MM = 12.0
LARGEST_Y_MM = 30.0
LARGEST_THETA_DEG = 20.0
LARGEST_Z_MM = 15.0
_START_Y_MM = HEXAGON_HOLE_Y_MM / 2.0


# A start may lie so far from the middle between the holes that its offset is still allowed.
_LARGEST_START_Y_MM = LARGEST_Y_MM - _START_Y_MM
_LARGEST_START_Z_MM = LARGEST_Z_MM + Z_TARGET_MM


# Only a peg in the right hole is as near as this to it.
SUCCESS_XY_MM = 6.0
SUCCESS_THETA_DEG = 10.0


def judge_flags(state: InsertionState[FusionOffset], *, max_steps: int, insertion_depth_mm: float) -> Flags:
    """Return the flags of an env step; success asks for depth, for the right hole, and for no flag."""
    reached = state.is_deeper_than(insertion_depth_mm) and _is_at_target(state.offset)
    return compute_flags(state, max_steps=max_steps, left_range=_left_range(state.offset), reached=reached)


def _left_range(offset: FusionOffset) -> bool:
    """Return whether an offset is beyond a limit; its z is compared with the rim's height, as the challenge does."""
    return (
        is_beyond(offset.x_mm, LARGEST_X_MM)
        or is_beyond(offset.y_mm, LARGEST_Y_MM)
        or is_beyond(offset.theta_deg, LARGEST_THETA_DEG)
        or is_beyond(offset.z_mm - RIM_MM, LARGEST_Z_MM)
    )


def _is_at_target(offset: FusionOffset) -> bool:
    near = abs(offset.x_mm) < SUCCESS_XY_MM and abs(offset.y_mm) < SUCCESS_XY_MM
    return near and abs(offset.theta_deg) < SUCCESS_THETA_DEG


class SeenObjects(TypedDict):
    """What the rig saw, after the challenge's entries; only where `object_point_cloud` is observed.

    Attributes:
        peg_seen: a pixel of the peg has a depth; otherwise its cloud is zeros.
        base_seen: the same of the base.
    """

    peg_seen: bool
    base_seen: bool


class FusionInsertionEnv(InsertionEnv[FusionScene, FusionInsertionSettings]):
    """Insert a peg into that of two holes which fits it, by sight and touch.

    A hexagonal or a cuboid peg hangs between two gels above a base with a hexagonal hole at larger y (left) and a
    rectangular one (right), about midway between them. Only the hole of the peg's own shape counts, though the hexagon
    goes into the rectangle too. Every env step moves the gripper as the action says; actions outside -1 to 1 are
    clipped. A camera rig follows the gripper in y and z. World frame: z up, origin at the rectangular hole's centre, in
    the upper face of the plate; the rim is 17.4 mm high.

    The grid of `marker_flow` is drawn again at every observation. Depth is what an active stereo camera measures
    (`depth_mode="stereo"`) or exact ("gt").

    Reset options: `start` (x mm and y mm from the middle between the holes, theta deg, z mm, 1 for left or 0 for
    right), `shape` ("hexagon" or "cuboid"; with `start` it must be that of the side) and `rng_seed`, the integers that
    seed the episode's generator in place of the environment's own. Without `start` one is drawn: x and y within 5 mm,
    theta within 10 degrees, z of 3 to 9 mm, either side.

    Ends: terminated by success (`end_reason` "success"); truncated by a sensing surface that moved more than 1.5 mm
    ("tactile"), an offset beyond 12 mm in x, 30 mm in y, 20 degrees or z of 2.4 to 32.4 mm ("error"), 50 env steps
    ("steps"), or physics that did not converge ("not_converged", after which nothing moves). An end that already
    happened in the reset is in the info of the reset.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `FusionInsertionSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = FusionInsertionSettings
    shape_type: ClassVar = FusionShape
    training_ranges: ClassVar = training_ranges("base_friction")
    option_names: ClassVar[tuple[str, ...]] = (START, SHAPE)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode; see the class for the options.

        Raises:
            ResetOptionsError: an option is unknown or out of range.
        """
        observation, info = super().reset(seed=seed, options=options)
        return observation, {**info, **self._seen_objects()}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Play one env step.

        Raises:
            ActionError: the action has another shape than the action space or is not finite.
        """
        observation, value, terminated, truncated, info = super().step(action)
        return observation, value, terminated, truncated, {**info, **self._seen_objects()}

    def _solids(self) -> list[SurfaceMesh]:
        pegs = [peg_mesh(self._meshes, target) for target in Target]
        return [*pegs, base_mesh(self._meshes, self.settings.clearance_mm)]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: FusionInsertionSettings
    ) -> FusionStart:
        """Return the start that the options give, or draw one: x, y, theta, z, and then the side.

        `start` has x and y from the middle between the holes [mm], theta [deg], z above the lowest start [mm], and 1
        for left or 0 for right; `shape` must then be that of the side, or else fixes the side of a drawn start.
        """
        wanted = options.get(START)
        shape = None if options.get(SHAPE) is None else choice(self.env_id, SHAPE, options[SHAPE], FusionShape)
        if wanted is not None:
            return _given(self.env_id, wanted, shape)
        x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
        lowest_mm, highest_mm = settings.random_z_mm
        z = random.uniform(lowest_mm, highest_mm)
        side = Target.LEFT if random.random() < 0.5 else Target.RIGHT
        if shape is None and side.shape not in self._shapes:
            (shape,) = self._shapes
        target = side if shape is None else Target.from_shape(shape)
        xy_mm = settings.random_xy_mm
        return _placed((x * xy_mm, y * xy_mm, theta * settings.random_theta_deg, z), target)

    def _start(self, options: Mapping[str, Any], random: np.random.Generator) -> FusionScene:
        settings = self.settings
        start = self.choose_start(options, random, settings)
        if settings.random_physics:
            drawn = drawn_settings(settings, self.training_ranges, random)
        else:
            drawn = self._settings_of_episode(random)
        return FusionScene(
            start=start,
            meshes=self._meshes,
            settings=drawn,
            clocks=self._clocks,
            rig=choose_rig(
                random,
                turn_rad=settings.random_camera_turn_rad,
                offset_m=settings.random_camera_offset_m,
                placed=RigShift(
                    turn_rad=radians(drawn.camera_turn_deg),
                    offset_m=(drawn.camera_x_mm * 1e-3, 0.0, drawn.camera_z_mm * 1e-3),
                ),
            ),
        )

    def _judge(self) -> Flags:
        settings = self.settings
        return judge_flags(
            self.task_scene.state(), max_steps=settings.max_steps, insertion_depth_mm=settings.insertion_depth_mm
        )

    def _seen_objects(self) -> Info:
        """Return which objects the observed clouds are of; nothing where they are not observed."""
        if OBJECT_POINT_CLOUD not in self._observables:
            return {}
        objects = self.task_scene.sight().objects
        seen: SeenObjects = {"peg_seen": objects.peg_seen, "base_seen": objects.base_seen}
        return {**seen}


_HOVER_MM = 0.6
_DEPTH_MM = 2.0
_CLOSE = 1e-3
# Offset z at which the peg's lower end is as high as the rim.
_RIM_OFFSET_MM = 9.5


def guide_to_the_hole(_: Observation, info: Info) -> ActionArray:
    """Take the offset away while hovering, then descend; the gripper's own axes turn with it."""
    *horizontal, z_mm = info["gt_offset_mm_deg"].tolist()
    there = max(abs(value) for value in horizontal) < _CLOSE
    height_mm = -_DEPTH_MM if there else _HOVER_MM
    way = (*way_to_the_hole(horizontal), _RIM_OFFSET_MM + height_mm - z_mm)
    return longest_action(np.array(way), np.array(TASK.action_scale))


def choose_rig(
    random: np.random.Generator, *, turn_rad: float, offset_m: float, placed: RigShift = NOMINAL
) -> RigVariation:
    """Draw the rig of an episode: four numbers, also where it is not shifted, and the noise from a child generator.

    The child leaves the numbers that the markers get as they are.

    Args:
        random: the episode's generator.
        turn_rad: largest turn either way [rad].
        offset_m: largest offset either way along every axis [m].
        placed: where it stands before that.
    """
    turn, x, y, z = random.uniform(-1.0, 1.0, 4).tolist()
    (noise,) = random.spawn(1)
    return RigVariation(
        shift=RigShift(
            turn_rad=placed.turn_rad + turn * turn_rad,
            offset_m=tuple(at + part * offset_m for at, part in zip(placed.offset_m, (x, y, z), strict=True)),
        ),
        noise_seed=int(noise.integers(2**63)),
    )


def _given(env_id: str, value: Any, shape: FusionShape | None) -> FusionStart:
    expected = (
        f"expected (x mm, y mm, theta deg, z mm, left 1 or right 0) with |x| of at most {LARGEST_X_MM:g}, |y| of at "
        f"most {_LARGEST_START_Y_MM:g}, |theta| of at most {LARGEST_THETA_DEG:g}, z of 0 to {_LARGEST_START_Z_MM:g}"
    )
    beside = either_way(LARGEST_X_MM, _LARGEST_START_Y_MM, LARGEST_THETA_DEG)
    x, y, theta, z, left = numbers(env_id, START, value, (*beside, (0.0, _LARGEST_START_Z_MM), (0.0, 1.0)), expected)
    if left not in (0.0, 1.0):
        raise refusal(env_id, START, value, expected)
    target = Target.LEFT if left else Target.RIGHT
    if shape is not None and target is not Target.from_shape(shape):
        raise refusal(env_id, SHAPE, shape.value, f"expected {target.shape}, which is the peg of the start's side")
    return _placed((x, y, theta, z), target)


def _placed(start: Sequence[float], target: Target) -> FusionStart:
    x, y, theta, z = start
    offset = FusionOffset(x_mm=x, y_mm=y + _START_Y_MM - target.y_mm, theta_deg=theta, z_mm=z + RIM_MM - Z_TARGET_MM)
    return FusionStart(offset=offset, target=target)
