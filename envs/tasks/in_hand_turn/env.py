"""`ViTac/InHandTurn-v1`: turn a rod between the gels that hold it, by pressing it against an edge.

First its scene: a rod with a flat head between two gels, beside the edge.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from math import degrees, isfinite, radians
from typing import Any, ClassVar

import numpy as np

from ...assets import Meshes
from ...deterministic_math import arctangent_deg, sine_cosine
from ...fem.model.mesh import GEL_MATERIAL, PART_MATERIAL, RigidBody, SurfaceMesh
from ...fem.model.settings import ArenaContactSettings
from ...geometry.solid import ZX_ALONG_Y, as_polygon, prism_faces, solid_from_faces
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...scene.perspective import ActionArray, FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import Flags, surface_moved_too_far
from ..quantities import check_quantities
from ..settings import SHAPE, arena_physics, choose_shape, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import HELD, TASK, TOLERANCE_DEG

ROD_THICKNESS_MM = 8.0
LEVER_MM = 24.0
"""Height of the gripper above the edge where the rod is held at its nominal place."""
_ABOVE_END_MM = 50.0
# Half of the head across the rod and along it: at any angle it is larger than the gels, wherever it is held.
_HEAD_HALF_MM = (13.0, 17.0)
_CORNER_MM = 6.0
_EDGE_HALF_WIDTH_MM = 2.0


LARGEST_Z_MM = 8.0
LARGEST_ANGLE_DEG = 75.0


_ROUNDING_MM = 1e-5
_GRASP_GAP_MM = 0.1
_WITHDRAWAL_MM = 12.0
_SPEED_M_S = 2e-2
_GEL_FRICTION = 0.3


class RodShape(StrEnum):
    """Rods by their width below the head."""

    NARROW = "narrow"
    WIDE = "wide"


WIDTH_MM = {RodShape.NARROW: 6.0, RodShape.WIDE: 10.0}


@cache
def rod_mesh(shape: RodShape) -> SurfaceMesh:
    """Return the rod along z, its head's middle in the origin, as thick along y as it is gripped."""
    half, (x, z), corner = 0.5 * WIDTH_MM[shape], _HEAD_HALF_MM, _CORNER_MM
    left = [(z, x - corner), (z - corner, x), (corner - z, x), (-z, x - corner), (-z, half), (-_ABOVE_END_MM, half)]
    outline = as_polygon([*left, *((along, -across) for along, across in reversed(left))])  # z, x
    faces = prism_faces(outline, -0.5 * ROD_THICKNESS_MM, 0.5 * ROD_THICKNESS_MM, axes=ZX_ALONG_Y)
    return solid_from_faces(faces, f"{shape} rod")


@cache
def edge_mesh() -> SurfaceMesh:
    """Return the bar that ends in the edge, along y at x = z = 0, and lies towards +x; both gels pass beside it."""
    outline = as_polygon([(0.0, 0.0), (0.0, 50.0), (-20.0, 50.0), (-20.0, 12.0)])  # z, x
    faces = prism_faces(outline, -_EDGE_HALF_WIDTH_MM, _EDGE_HALF_WIDTH_MM, axes=ZX_ALONG_Y)
    return solid_from_faces(faces, "bar with an edge")


def turn_physics() -> PhysicsSettings:
    """Return the contact model arena-2 with its gel, on which the rod slides easily; the rest as in the peg task."""
    frictions = tuple(
        replace(pair, coefficient=_GEL_FRICTION) if {pair.first, pair.second} == {GEL_MATERIAL, PART_MATERIAL} else pair
        for pair in ArenaContactSettings().pair_frictions
    )
    return replace(arena_physics(), contact=ArenaContactSettings(pair_frictions=frictions))


@dataclass(frozen=True, kw_only=True)
class InHandTurnSettings:
    """What the task leaves open; lengths in mm and angles in degrees.

    Attributes:
        max_steps: env steps of an episode.
        action_scale_mm: motion at an action of 1: x [mm], z [mm].
        tolerance_deg: largest error of the angle that is a success.
        final_reward: reward of success.
        indentation_mm: how far each gel is pressed into the rod.
        held_mm: where the rod is held, above its nominal place.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 14
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    tolerance_deg: float = TOLERANCE_DEG
    final_reward: float = 10.0
    indentation_mm: float = 0.35
    held_mm: float = HELD.nominal
    physics: PhysicsSettings = field(default_factory=turn_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        scale = self.action_scale_mm
        usable = len(scale) == len(TASK.actions) and all(isfinite(value) and 0 <= value <= 10 for value in scale)
        require(usable, "action_scale_mm", scale, "two numbers of 0 to 10")
        require(0 < self.tolerance_deg <= 90, "tolerance_deg", self.tolerance_deg, "0 to 90 degrees")
        require(0 < self.indentation_mm <= 2, "indentation_mm", self.indentation_mm, "0 to 2 mm, half the gel")
        check_quantities(self, (HELD,))


@dataclass(frozen=True, kw_only=True)
class TurnStart:
    """Start of an episode.

    Attributes:
        shape: of the rod.
        gap_mm: from the edge to the rod, along x.
        angle_deg: of the rod in the hand.
        goal_deg: to which it is to be turned.
    """

    shape: RodShape
    gap_mm: float
    angle_deg: float
    goal_deg: float


class InHandTurnScene:
    """A rod in the hand beside an edge, and the gripper's motions across it.

    Angles are from the vertical, positive where the rod's lower end is away from the edge, as pressing turns it.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        shape: of the rod.
        goal_deg: angle to which it is to be turned.
        moved_too_far: a sensing surface had, before the gripper withdrew.
        has_left_range: the gripper or the rod had.
    """

    def __init__(self, *, start: TurnStart, meshes: Meshes, settings: InHandTurnSettings, clocks: Clocks) -> None:
        self._settings = settings
        self.shape, self.goal_deg = start.shape, start.goal_deg
        self.env_steps = 0
        self.moved_too_far = self.has_left_range = False
        self._free_deg = start.angle_deg
        rod = rod_mesh(start.shape)
        heights_m = rod.vertices_m[:, 2]
        self._ends = tuple(np.flatnonzero(heights_m == height_m) for height_m in (heights_m.min(), heights_m.max()))
        sine, cosine = sine_cosine(radians(start.angle_deg))
        lever_mm = LEVER_MM + settings.held_mm
        x_mm = (sine * lever_mm - 0.5 * WIDTH_MM[start.shape]) / cosine - start.gap_mm
        self._start = GripperPose(
            x_m=x_mm * 1e-3,
            y_m=0.0,
            z_m=lever_mm * 1e-3,
            angle_rad=0.0,
            half_opening_m=(0.5 * ROD_THICKNESS_MM + highest_mm(meshes.gel()) + _GRASP_GAP_MM) * 1e-3,
        )
        middle_mm = np.array([x_mm - sine * settings.held_mm, 0.0, lever_mm - cosine * settings.held_mm])
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=self._start),
            held=RigidBody(
                mesh=rod,
                rotation=np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]),
                translation_m=middle_mm * 1e-3,
                density_kg_m3=settings.physics.rigid_density_kg_m3,
            ),
            fixed=fixed_at_origin(edge_mesh(), friction=0.5),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Close on the rod's head and take the references."""
        self._travel(closing_m=(_GRASP_GAP_MM + self._settings.indentation_mm) * 1e-3)
        self.grasped.capture_references()
        self._note_angle()

    def move(self, command: FloatArray) -> None:
        """Move the gripper as an action says; at the end of the episode it then withdraws from the edge."""
        x_m, z_m = (1e-3 * np.clip(command, -1.0, 1.0) * np.array(self._settings.action_scale_mm)).tolist()
        self._travel(x_m=x_m, z_m=z_m)
        self.moved_too_far = surface_moved_too_far(self.grasped.surface_diff_m())
        rose_mm = abs(float(self.relative_motion_mm()[1]))
        self.has_left_range = rose_mm > LARGEST_Z_MM + _ROUNDING_MM or abs(self.angle_deg()) > LARGEST_ANGLE_DEG
        if self.moved_too_far or self.has_left_range or self.env_steps >= self._settings.max_steps:
            self._travel(x_m=-1e-3 * _WITHDRAWAL_MM)
            self._note_angle()

    def free_error_deg(self) -> float:
        """Return how far from its goal the rod is where nothing but the gripper has held it last [deg]."""
        return abs(self.goal_deg - self._free_deg)

    def _note_angle(self) -> None:
        if self.grasped.solved:
            self._free_deg = self.angle_deg()

    def angle_deg(self) -> float:
        """Return the angle of the rod now [deg]."""
        low, high = (self.grasped.held_vertices_m(end).mean(axis=0) for end in self._ends)
        return arctangent_deg(float(high[0] - low[0]), float(high[2] - low[2]))

    def twist_deg(self) -> float:
        """Return how far the rod has twisted the gels since the grasp [deg]: about as far it turns back when freed.

        It is the mean turn about the gripper's axis of what is seen of both sensing faces, weighted by the square of
        the distance from it.
        """
        turned = inertia = 0.0
        for side, (first, now) in zip((-1.0, 1.0), self.grasped.surface_points_m(), strict=True):
            z, x = first[:, 0], side * first[:, 1]
            turned += float((z * (side * now[:, 1] - x) - x * (now[:, 0] - z)).sum())
            inertia += float((x * x + z * z).sum())
        return degrees(turned / inertia)

    def gap_mm(self) -> float:
        """Return how far the rod is from the edge, along x at its height [mm]."""
        low, high = (self.grasped.held_vertices_m(end).mean(axis=0) * 1e3 for end in self._ends)
        along = (high - low) / (high[2] - low[2])
        half_mm = 0.5 * WIDTH_MM[self.shape]
        return float(along[0] * low[2] - low[0] - half_mm * np.sqrt(1.0 + along[0] * along[0]))

    def edge_mm(self) -> FloatArray:
        """Return where the edge is from the gripper's centre, x and z [mm], shape [2]."""
        pose = self.grasped.pose
        return np.array([-pose.x_m, -pose.z_m]) * 1e3

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded motion since the start, x and z [mm], shape [2]."""
        now, first = self.grasped.pose, self._start
        return np.array([now.x_m - first.x_m, now.z_m - first.z_m]) * 1e3

    def _travel(self, *, x_m: float = 0.0, z_m: float = 0.0, closing_m: float = 0.0) -> None:
        longest_m = max(abs(x_m), abs(z_m), abs(closing_m))
        steps = ipc_steps(longest_m, speed_per_s=_SPEED_M_S, time_step_s=self._settings.physics.time_step_s)
        self.grasped.move_to(self.grasped.pose.moved(x_m=x_m, z_m=z_m, closing_m=closing_m), ipc_steps=steps)


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
