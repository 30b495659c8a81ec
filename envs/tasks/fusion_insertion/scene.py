"""Scene of the fusion task: settings, parts, a peg held by two gels above a base with two holes, and the rig."""

from dataclasses import dataclass
from enum import StrEnum

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
from ...vision.camera import DepthMode, RigCamera, Sight
from ...vision.look import CHALLENGE_LOOK, Look, Rectangle, build_surroundings, draw_clutter
from ...vision.pinhole import RigShift, colour_camera_pose
from ...vision.rasterizer import Body, Label
from ..insertion.interface import PegOffset
from ..insertion.scene import InsertionScene, InsertionSettings, Parts, check_friction, check_settings, lay
from ..quantities import check_quantities
from ..settings import require
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
