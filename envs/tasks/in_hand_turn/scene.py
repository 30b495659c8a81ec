"""Scene of the turn in the hand: a rod with a flat head between two gels, beside an edge that it is pressed against."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from math import degrees, isfinite, radians

import numpy as np

from ...assets import Meshes
from ...deterministic_math import arctangent_deg, sine_cosine
from ...fem.model.mesh import GEL_MATERIAL, PART_MATERIAL, RigidBody, SurfaceMesh
from ...fem.model.settings import ArenaContactSettings
from ...geometry.solid import ZX_ALONG_Y, as_polygon, prism_faces, solid_from_faces
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...scene.perspective import FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import surface_moved_too_far
from ..quantities import check_quantities
from ..settings import arena_physics, require
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
