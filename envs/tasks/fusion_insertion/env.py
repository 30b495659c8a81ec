"""`ViTac/FusionInsertion-v1`: see which hole fits the peg, go there, and insert it by touch.

First its scene: settings, parts, a peg held by two gels above a base with two holes, and the rig of its cameras.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import radians
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...fem.model.settings import ContactModel
from ...geometry.bases import (
    HEXAGON_HOLE_Y_MM,
    LARGEST_CLEARANCE_MM,
    OFFICIAL_CLEARANCE_MM,
    RIM_MM,
    base_surface,
    hexagon_bottom_vertices,
    hexagon_peg_surface,
)
from ...geometry.pegs import PegShape, bottom_vertices, peg_surface
from ...scene.grasped_scene import Clocks
from ...scene.perspective import ActionArray, longest_action
from ...vision.camera import DepthMode, RigCamera, Sight
from ...vision.look import CHALLENGE_LOOK, Look, Rectangle, build_surroundings, draw_clutter
from ...vision.observables import OBJECT_POINT_CLOUD
from ...vision.pinhole import NOMINAL, RigShift, colour_camera_pose
from ...vision.rasterizer import Body, Label
from ..definition import Flags
from ..insertion.env import (
    InsertionEnv,
    InsertionScene,
    InsertionSettings,
    InsertionState,
    Parts,
    check_friction,
    check_settings,
    compute_flags,
    lay,
    training_ranges,
    way_to_the_hole,
)
from ..insertion.interface import PegOffset, is_beyond
from ..quantities import check_quantities, drawn_settings
from ..settings import SHAPE, choice, either_way, numbers, refusal, require
from ..task_env import Info, Observation
from .definition import CAMERA_QUANTITIES, CAMERA_TURN, CAMERA_X, CAMERA_Z, PICTURE_DELAY, TASK


@dataclass(frozen=True, kw_only=True)
class FusionInsertionSettings(InsertionSettings):
    """What the task leaves open beside what all do that insert a peg.

    Attributes:
        insertion_depth_mm: how deep all of the peg's lower end must be below the rim.
        base_friction: friction coefficient of the base.
        clearance_mm: gap between a centred peg and its hole; other bases than the evaluated one are for training.
        depth_mode: "stereo" as the camera measures depth, which is scored; "gt" for the exact one.
        look: colours, light and clutter in the pictures.
        picture_delay: part of an env step by which pictures lag behind, from 0 to 1.
        camera_x_mm: offset of the rig from its nominal place along the world's x, away from the base.
        camera_z_mm: the same upwards.
        camera_turn_deg: turn of the rig about the world's y axis.
        random_z_mm: smallest and largest z of a random start.
        random_physics: draw friction, indentation and grip for every episode, over the challenge's training ranges
            and in place of the values above; for training.
        random_camera_turn_rad: largest turn of the rig either way, drawn for every episode; for training.
        random_camera_offset_m: largest offset of the rig either way along every axis; for training.
    """

    max_steps: int = 50
    action_scale_mm_deg: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 0.8
    final_reward: float = 50.0
    insertion_depth_mm: float = 1.0
    base_friction: float = 0.5
    clearance_mm: float = OFFICIAL_CLEARANCE_MM
    depth_mode: str = DepthMode.STEREO.value
    look: Look = CHALLENGE_LOOK
    picture_delay: float = PICTURE_DELAY.nominal
    camera_x_mm: float = CAMERA_X.nominal
    camera_z_mm: float = CAMERA_Z.nominal
    camera_turn_deg: float = CAMERA_TURN.nominal
    random_z_mm: tuple[float, ...] = (3.0, 9.0)
    random_physics: bool = False
    random_camera_turn_rad: float = 0.0
    random_camera_offset_m: float = 0.0

    def __post_init__(self) -> None:
        check_settings(self, action_numbers=len(TASK.actions))
        check_friction("base_friction", self.base_friction)
        depth, clearance = self.insertion_depth_mm, self.clearance_mm
        require(0 < depth <= 12, "insertion_depth_mm", depth, "0 to 12 mm, less than the hole's depth")
        require(0 < clearance < LARGEST_CLEARANCE_MM, "clearance_mm", clearance, "more than 0 and less than 7.5 mm")
        require(self.depth_mode in set(DepthMode), "depth_mode", self.depth_mode, f"one of {', '.join(DepthMode)}")
        check_quantities(self, CAMERA_QUANTITIES)
        self._check_random_ranges()

    def _check_random_ranges(self) -> None:
        require(0 <= self.random_xy_mm <= 7, "random_xy_mm", self.random_xy_mm, "0 to 7 mm")
        require(0 <= self.random_theta_deg <= 20, "random_theta_deg", self.random_theta_deg, "0 to 20 degrees")
        z = self.random_z_mm
        require(len(z) == 2 and 0 <= z[0] <= z[1] <= 20, "random_z_mm", z, "two numbers of 0 to 20 mm, rising")
        turn, offset = self.random_camera_turn_rad, self.random_camera_offset_m
        require(0 <= turn <= 0.1, "random_camera_turn_rad", turn, "0 to 0.1 rad")
        require(0 <= offset <= 0.05, "random_camera_offset_m", offset, "0 to 0.05 m")


# Height of the peg's lower end above the rim at z = 0.
START_GAP_MM = 1.0
# What the challenge takes off every height to get an offset.
Z_TARGET_MM = 6.9


class FusionShape(StrEnum):
    """Which peg is held."""

    HEXAGON = "hexagon"
    CUBOID = "cuboid"


class Target(StrEnum):
    """Which hole is the right one; it says which peg is held, too."""

    LEFT = "left"  # the hexagonal hole, at larger y
    RIGHT = "right"  # the rectangular hole, at the origin

    @classmethod
    def from_shape(cls, shape: FusionShape) -> "Target":
        """Return the hole that a peg belongs into."""
        return cls.LEFT if shape is FusionShape.HEXAGON else cls.RIGHT

    @property
    def shape(self) -> FusionShape:
        """Peg that belongs into the hole."""
        return FusionShape.HEXAGON if self is Target.LEFT else FusionShape.CUBOID

    @property
    def y_mm(self) -> float:
        """Centre of the hole in the world [mm]."""
        return HEXAGON_HOLE_Y_MM if self is Target.LEFT else 0.0

    @property
    def direction(self) -> float:
        """1 for left, -1 for right, as in the challenge's `gt_direction`."""
        return 1.0 if self is Target.LEFT else -1.0


@dataclass(frozen=True, kw_only=True)
class FusionOffset(PegOffset):
    """Pose of the peg (and the gripper) relative to the right hole.

    Attributes:
        z_mm: 9.5 where the peg's lower end is as high as the rim [mm].
    """

    z_mm: float


@dataclass(frozen=True, kw_only=True)
class FusionStart:
    """Start of an episode: where the peg stands, and which hole is the right one."""

    offset: FusionOffset
    target: Target


@dataclass(frozen=True, kw_only=True)
class RigVariation:
    """What differs between the rigs of two episodes.

    Attributes:
        shift: departure from the nominal pose.
        noise_seed: seed of the noise in its pictures.
    """

    shift: RigShift
    noise_seed: int


class BaseElsewhere(VitacError):
    """The base in the assets folder does not stand where the task expects it; use the one with 2.0 mm of clearance."""


def peg_mesh(meshes: Meshes, target: Target) -> SurfaceMesh:
    """Return the peg for this hole."""
    if target is Target.LEFT:
        return meshes.part(hexagon_peg_surface, "peg_in_hole/hexagon_peg.STL")
    return meshes.part(lambda: peg_surface(PegShape.CUBOID), "peg_in_hole/cuboid_peg.STL")


def peg_bottom(peg: SurfaceMesh, target: Target) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Find the vertices at the lower corners of a peg, in the order of the logs."""
    bottom = hexagon_bottom_vertices(peg) if target is Target.LEFT else bottom_vertices(PegShape.CUBOID, peg)
    return np.asarray(bottom, dtype=np.int64)


def base_mesh(meshes: Meshes, clearance_mm: float) -> SurfaceMesh:
    """Return the base with both holes and garages.

    Raises:
        BaseElsewhere: it was read from a file that has another origin, as the challenge's with 1.0 mm has.
    """
    base = meshes.part(lambda: base_surface(clearance_mm), f"peg_in_hole/sim_hole_base_{clearance_mm:.1f}mm.STL")
    rim_mm = float(base.vertices_m[:, 2].max()) * 1e3
    if abs(rim_mm - RIM_MM) > 1e-3:
        raise BaseElsewhere(f"The rim of {base.name} is {rim_mm:.3f} mm high, expected {RIM_MM:g} mm.")
    return base


# Sets the numbers of clutter apart from the noise, whose stream has the number of the env step here.
_CLUTTER_STREAM = 2**32


@dataclass(frozen=True, kw_only=True, eq=False)
class _Visible:
    """What the rig looks at, at one moment.

    Attributes:
        positions_m: vertices of each body [m], in the order of `FusionScene._visible_bodies`.
        y_m: commanded y of the peg, which the rig follows [m].
        z_m: 1 mm below the commanded height of the peg's lower end [m].
    """

    positions_m: list[NDArray[np.float64]]
    y_m: float
    z_m: float

    def mixed(self, before: "_Visible", part: float) -> "_Visible":
        """Return what is between this and an earlier moment, of which it has a part."""
        pairs = zip(before.positions_m, self.positions_m, strict=True)
        return _Visible(
            positions_m=[part * earlier_m + (1.0 - part) * now_m for earlier_m, now_m in pairs],
            y_m=part * before.y_m + (1.0 - part) * self.y_m,
            z_m=part * before.z_m + (1.0 - part) * self.z_m,
        )


class FusionScene(InsertionScene[FusionOffset, FusionInsertionSettings]):
    """A fusion scene, and what the rig sees.

    Attributes:
        target: which hole is the right one.
    """

    def __init__(
        self,
        *,
        start: FusionStart,
        meshes: Meshes,
        settings: FusionInsertionSettings,
        clocks: Clocks,
        rig: RigVariation,
    ) -> None:
        self._rig_variation = rig
        self.target: Target = start.target
        peg = peg_mesh(meshes, start.target)
        parts = Parts(
            sensors=meshes.sensors(settings.markers),
            peg=peg,
            peg_bottom=peg_bottom(peg, start.target),
            fixed=lay(self._place_fixed(base_mesh(meshes, settings.clearance_mm), settings.base_friction), settings),
            rim_mm=RIM_MM,
        )
        super().__init__(parts, offset=start.offset, settings=settings, clocks=clocks)
        # A generator of its own, so that clutter leaves the noise of the pictures as it is.
        clutter = draw_clutter(settings.look, np.random.default_rng((rig.noise_seed, _CLUTTER_STREAM)))
        self._around: tuple[tuple[SurfaceMesh | Rectangle, Label], ...] = clutter
        # Pictures of 2025 have a white background.
        if settings.physics.contact.model is ContactModel.ARENA_2:
            self._around += build_surroundings()
        self._rig = RigCamera(self._visible_bodies(), DepthMode(settings.depth_mode), settings.look)
        self._sight: Sight | None = None
        self._before: _Visible | None = None

    @property
    def shape(self) -> FusionShape:
        """Which peg is held."""
        return self.target.shape

    @property
    def direction(self) -> float:
        """Which peg and hole it plays: 1 left, the hexagon; -1 right, the cuboid."""
        return self.target.direction

    def grasp(self) -> None:
        """Close on the peg in free air, and take the references."""
        super().grasp()
        self._sight = None

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there, all axes together."""
        dx, dy, dtheta, dz = self._scaled(command)
        now = self.offset
        goal = FusionOffset(
            x_mm=now.x_mm + dx, y_mm=now.y_mm + dy, theta_deg=now.theta_deg + dtheta, z_mm=now.z_mm + dz
        )
        self._sight = None
        self._before = self._visible() if self._settings.picture_delay > 0.0 else None
        distance_mm = max(abs(goal.x_mm - now.x_mm), abs(goal.y_mm - now.y_mm), abs(goal.z_mm - now.z_mm))
        self._travel(goal, ipc_steps=self._steps_to(goal, distance_mm))

    def sight(self) -> Sight:
        """Return what the rig sees now; looked at once, however often it is asked for before the next motion.

        Its noise follows from the episode's and the number of the env step, so that the pictures of an env step are the
        same whether those before were looked at or not.
        """
        if self._sight is None:
            seen = self._visible()
            if self._before is not None:
                seen = seen.mixed(self._before, self._settings.picture_delay)
            random = np.random.default_rng((self._rig_variation.noise_seed, self.env_steps))
            pose = colour_camera_pose(seen.y_m, seen.z_m, self._rig_variation.shift)
            self._sight = self._rig.look(seen.positions_m, pose, random)
        return self._sight

    def _visible(self) -> "_Visible":
        grasped = self.grasped
        peg_m = grasped.held_vertices_m(np.arange(len(grasped.held_surface.vertices_m)))
        positions_m = [grasped.fixed_surface().vertices_m, peg_m, grasped.gel_nodes_m(0), grasped.gel_nodes_m(1)]
        return _Visible(
            positions_m=[*positions_m, *(solid.vertices_m for solid, _ in self._around)],
            y_m=(self.offset.y_mm + self.target.y_mm) * 1e-3,
            z_m=(self.offset.z_mm + Z_TARGET_MM) * 1e-3,
        )

    def _lower_end_mm(self, offset: FusionOffset) -> tuple[float, float, float]:
        return offset.x_mm, offset.y_mm + self.target.y_mm, offset.z_mm + Z_TARGET_MM + START_GAP_MM

    def _visible_bodies(self) -> list[Body]:
        """Return base, peg, both gels and what stands around, in the order in which `sight` gives their positions."""
        grasped = self.grasped
        solids = ((grasped.fixed.mesh, Label.BASE), (grasped.held_surface, Label.PEG))
        gel = grasped.gel
        return [
            *(Body(vertex_count=len(mesh.vertices_m), triangles=mesh.triangles, label=label) for mesh, label in solids),
            *(
                Body(vertex_count=len(gel.rest_position_m), triangles=gel.surface_triangles, label=label)
                for label in (Label.LEFT_GEL, Label.RIGHT_GEL)
            ),
            *(
                Body(vertex_count=len(solid.vertices_m), triangles=solid.triangles, label=label)
                for solid, label in self._around
            ),
        ]


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
