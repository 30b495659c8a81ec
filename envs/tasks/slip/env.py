"""`ViTac/Slip-v1`: hold a part under a load that grows with as little force as it takes, and set it down.

First its scene: the part on a table, the load on it, and a gripper whose width is commanded.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import sqrt
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import GEL_MATERIAL, PART_MATERIAL, PointLoad, PointMass, RigidBody, SurfaceMesh
from ...geometry.bases import regular_hexagon_mm
from ...geometry.solid import Polygon, prism_faces, rectangle, solid_from_faces
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from ...scene.perspective import ActionArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import Flags, surface_moved_too_far
from ..quantities import check_quantities
from ..settings import SHAPE, arena_physics, choose_shape, either_way, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import CENTRE_OF_MASS, LOAD, MASS, PART_QUANTITIES, STANDING_MM, TASK

FloatArray = NDArray[np.float64]


GRIPPED_WIDTH_MM, PART_HEIGHT_MM = 30.0, 50.0
GRASP_HEIGHT_MM = 30.0
TABLE_MM = rectangle(-45.0, 45.0, -30.0, 30.0)
TABLE_THICKNESS_MM = 6.0
# Free space below the part and beside the gels when the scene is built.
START_GAP_MM = 0.1
# IPC steps in which the part comes to rest on the table and the gels close on it.
GRASP_STEPS = 2
GRAVITY_M_S2 = 9.81
# Mean distance of the places where a gel presses from their middle.
PATCH_MM = 6.0
# Share of the part's mass that is spread over it; the rest is a weight inside, twice as far off as the centre of mass.
_SPREAD = 0.5


class SlipShape(StrEnum):
    """Cross-section of the part."""

    BLOCK = "block"
    """24 mm along x."""
    BAR = "bar"
    """12 mm along x, narrower than the gels."""
    COLUMN = "column"
    """A regular hexagon."""


def slip_physics() -> PhysicsSettings:
    """Return the contact model arena-2 with its gel, gravity, and IPC steps of 0.2 s."""
    return replace(arena_physics(), time_step_s=0.2, gravity_m_s2=GRAVITY_M_S2)


@dataclass(frozen=True, kw_only=True)
class SlipSettings:
    """What the task leaves open.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        ipc_steps: of an env step.
        action_scale_mm: motion at an action of 1: height, width.
        touching_width_mm: width of the gripper at the start, at which both gels just touch the part.
        part_mass_kg: mass of the part.
        centre_of_mass_mm: where it is along x from the part's middle.
        load_n: load in the end, downwards through the centre of mass.
        load_first_step: env step in which the load begins to grow.
        load_last_step: env step in which it has grown.
        crush_ratio: a jaw that presses with more than this times the force that holds the whole load crushes the part.
        step_penalty: of an env step in the reward.
        final_reward: of success.
        failure_penalty: of the flags that end an episode.
        random_x_mm: largest |x| of a random start.
        random_z_mm: largest |z| of a random start.
        physics: materials and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 28
    ipc_steps: int = 1
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    touching_width_mm: float = 30.16
    part_mass_kg: float = MASS.nominal
    centre_of_mass_mm: float = CENTRE_OF_MASS.nominal
    load_n: float = LOAD.nominal
    load_first_step: int = 8
    load_last_step: int = 16
    crush_ratio: float = 1.5
    step_penalty: float = 0.1
    final_reward: float = 10.0
    failure_penalty: float = 10.0
    random_x_mm: float = 1.5
    random_z_mm: float = 3.0
    physics: PhysicsSettings = field(default_factory=slip_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        require(1 <= self.ipc_steps <= 100, "ipc_steps", self.ipc_steps, "1 to 100")
        scale = self.action_scale_mm
        usable = len(scale) == len(TASK.actions) and all(0 <= value <= 5 for value in scale)
        require(usable, "action_scale_mm", scale, "two numbers of 0 to 5")
        width_mm, wide_mm = self.touching_width_mm, GRIPPED_WIDTH_MM + 2.0 * START_GAP_MM
        require(28 <= width_mm <= wide_mm, "touching_width_mm", width_mm, f"28 to {wide_mm:g} mm")
        check_quantities(self, PART_QUANTITIES)
        first, last = self.load_first_step, self.load_last_step
        require(1 <= first <= last, "load_first_step", first, f"1 to load_last_step = {last}")
        require(self.crush_ratio > 1, "crush_ratio", self.crush_ratio, "more than 1")
        require(0 <= self.random_x_mm <= 5, "random_x_mm", self.random_x_mm, "0 to 5 mm")
        require(0 <= self.random_z_mm <= 10, "random_z_mm", self.random_z_mm, "0 to 10 mm")

    @property
    def gel_friction(self) -> float:
        """Friction coefficient of the gels on the part."""
        pairs = self.physics.contact.pair_frictions  # type: ignore[union-attr]
        return next(pair.coefficient for pair in pairs if {pair.first, pair.second} == {GEL_MATERIAL, PART_MATERIAL})

    @property
    def weight_n(self) -> float:
        """Weight of the part [N]."""
        return self.part_mass_kg * self.physics.gravity_m_s2

    @property
    def largest_grip_n(self) -> float:
        """Force of a jaw beyond which the part is crushed [N]."""
        return self.crush_ratio * (self.weight_n + self.load_n) / (2.0 * self.gel_friction)


def part_mesh(shape: SlipShape) -> SurfaceMesh:
    """Return the part of this shape, its lower face at z = 0."""
    return solid_from_faces(prism_faces(_profile_mm(shape), 0.0, PART_HEIGHT_MM), str(shape))


def _profile_mm(shape: SlipShape) -> Polygon:
    half_mm = 0.5 * GRIPPED_WIDTH_MM
    if shape is SlipShape.COLUMN:
        return regular_hexagon_mm((0.0, 0.0), half_mm)
    x_mm = {SlipShape.BLOCK: 12.0, SlipShape.BAR: 6.0}[shape]
    return rectangle(-x_mm, x_mm, -half_mm, half_mm)


def table_mesh() -> SurfaceMesh:
    """Return the table, its upper face at z = 0."""
    return solid_from_faces(prism_faces(TABLE_MM, -TABLE_THICKNESS_MM, 0.0), "table")


@dataclass(frozen=True, kw_only=True)
class SlipStart:
    """Start of an episode.

    Attributes:
        shape: of the part.
        x_mm: grasp beside the part's middle.
        z_mm: grasp above its nominal height.
    """

    shape: SlipShape
    x_mm: float
    z_mm: float


@dataclass(frozen=True, kw_only=True)
class GrowingLoad:
    """A load that grows evenly from a first to a last moment, as the load of a part.

    Attributes:
        first_s: when it begins.
        last_s: when it has grown.
        force_n: how large it is then, downwards.
        point_mm: where it acts, in the part's frame.
    """

    first_s: float
    last_s: float
    force_n: float
    point_mm: tuple[float, float, float]

    def at(self, time_s: float) -> float:
        """Return the load at a time since the scene was built [N]."""
        part = (time_s - self.first_s) / (self.last_s - self.first_s)
        return self.force_n * min(1.0, max(0.0, part))

    def __call__(self, time_s: float) -> PointLoad:
        """Return the force at a time since the scene was built, and where it acts."""
        return PointLoad(np.array([0.0, 0.0, -self.at(time_s)]), 1e-3 * np.array(self.point_mm))


class SlipScene:
    """A part that stands on a table, and the motions of the gripper around it.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        shape: of the part.
        load: on the part.
        fallen_mm: how far the part slid down in the grasp in the last env step.
    """

    def __init__(self, *, start: SlipStart, meshes: Meshes, settings: SlipSettings, clocks: Clocks) -> None:
        self.shape, self.env_steps, self.fallen_mm = start.shape, 0, 0.0
        self._settings, self._forces_n = settings, list[float]()
        part, com_mm = part_mesh(start.shape), settings.centre_of_mass_mm
        self.measured_vertices = np.flatnonzero(part.vertices_m[:, 2] == 0.0)
        self._closing_m = (START_GAP_MM + 0.5 * (GRIPPED_WIDTH_MM - settings.touching_width_mm)) * 1e-3
        step_s, middle_mm = settings.physics.time_step_s, 0.5 * PART_HEIGHT_MM
        self.load = GrowingLoad(
            first_s=step_s * (GRASP_STEPS + settings.ipc_steps * (settings.load_first_step - 1)),
            last_s=step_s * (GRASP_STEPS + settings.ipc_steps * settings.load_last_step),
            force_n=settings.load_n,
            point_mm=(com_mm, 0.0, middle_mm),
        )
        weight_m = 1e-3 * np.array([com_mm / (1.0 - _SPREAD), 0.0, middle_mm])
        self._open_pose = GripperPose(
            x_m=1e-3 * start.x_mm,
            y_m=0.0,
            z_m=1e-3 * (START_GAP_MM + GRASP_HEIGHT_MM + start.z_mm),
            angle_rad=0.0,
            half_opening_m=1e-3 * (0.5 * GRIPPED_WIDTH_MM + highest_mm(meshes.gel()) + START_GAP_MM),
        )
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=self._open_pose),
            held=RigidBody(
                mesh=part,
                rotation=np.eye(3),
                translation_m=np.array([0.0, 0.0, 1e-3 * START_GAP_MM]),
                density_kg_m3=_SPREAD * settings.part_mass_kg / part.volume_m3,
                point_masses=(PointMass((1.0 - _SPREAD) * settings.part_mass_kg, weight_m),),
                load=self.load,
            ),
            fixed=fixed_at_origin(table_mesh(), friction=0.5),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Touch the part that stands on the table, and take the references."""
        goal = self._open_pose.moved(closing_m=self._closing_m)
        self.grasped.move_to(goal, ipc_steps=GRASP_STEPS)
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        """Move the gripper up and open it as an action says, both together."""
        up_mm, wider_mm = (np.clip(command, -1.0, 1.0) * np.array(self._settings.action_scale_mm)).tolist()
        before_m = self._height_in_grasp_m()
        goal = self.grasped.pose.moved(z_m=1e-3 * up_mm, closing_m=-0.5e-3 * wider_mm)
        self.grasped.move_to(goal, ipc_steps=self._settings.ipc_steps)
        self.fallen_mm = 1e3 * (before_m - self._height_in_grasp_m())
        if self.is_loading:
            self._forces_n = [*self._forces_n, self.grasped.grip_force_n()]

    @property
    def is_loading(self) -> bool:
        """Whether the load grows in the present env step."""
        return self._settings.load_first_step <= self.env_steps <= self._settings.load_last_step

    @property
    def mean_grip_force_n(self) -> float:
        """Mean grip force at the ends of the env steps in which the load grows [N]; one not reached has the largest."""
        count = 1 + self._settings.load_last_step - self._settings.load_first_step
        missing = count - len(self._forces_n)
        return (sum(self._forces_n) + missing * self.largest_grip_n) / count

    def heights_mm(self) -> FloatArray:
        """Return the heights of the part's lower corners above the table [mm], shape [n]."""
        return self.grasped.held_vertices_m(self.measured_vertices)[:, 2] * 1e3

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded height of the gripper above that of the start [mm], shape [1]."""
        return np.array([1e3 * (self.grasped.pose.z_m - self._open_pose.z_m)])

    def properties(self) -> FloatArray:
        """Return mass [kg], centre of mass [mm], friction coefficient and load at the end [N], shape [4]."""
        settings = self._settings
        return np.array([settings.part_mass_kg, settings.centre_of_mass_mm, settings.gel_friction, settings.load_n])

    def load_n(self, later_env_steps: int = 0) -> FloatArray:
        """Return the load now, or a number of env steps later [N], shape [1]."""
        settings = self._settings
        later_s = later_env_steps * settings.ipc_steps * settings.physics.time_step_s
        return np.array([self.load.at(self.grasped.time_s + later_s)])

    def needed_grip_n(self) -> float:
        """Return the force of each jaw by which friction just holds weight and load at the end of the next env step.

        Coulomb's law for a limit surface that is an ellipse of force and moment (Howe & Cutkosky 1996), with a patch
        whose mean distance from its middle is `PATCH_MM`.
        """
        settings = self._settings
        force_n = settings.weight_n + float(self.load_n(1)[0])
        lever_mm = settings.centre_of_mass_mm - 1e3 * self._open_pose.x_m
        return force_n * sqrt(1.0 + lever_mm * lever_mm / (PATCH_MM * PATCH_MM)) / (2.0 * settings.gel_friction)

    @property
    def largest_grip_n(self) -> float:
        """Force of a jaw beyond which the part is crushed [N]."""
        return self._settings.largest_grip_n

    def _height_in_grasp_m(self) -> float:
        """Return the mean height of the part's lower corners below the gripper, negative [m]."""
        heights_m: list[float] = self.grasped.held_vertices_m(self.measured_vertices)[:, 2].tolist()
        return sum(heights_m) / len(heights_m) - self.grasped.pose.z_m


OFFSET = "offset_mm"
LARGEST_X_MM, LARGEST_Z_MM = 5.0, 10.0
CLEAR_MM = 0.5
"""Least height above the table at which the part has to hang while the load grows."""
LARGEST_FALL_MM = 1.5
"""By which the part may slide down in the grasp in an env step: by more than the gripper can rise."""
FREE_N = 0.02
"""Grip force below which the part is let go."""
LIFTED_MM = 3.0


class SlipEnv(TactileTaskEnv[SlipScene, SlipSettings]):
    """Lift a part, hold it while a load on it grows, and set it down, with as little force as it takes.

    The part stands on a table, just touched by both gels; its mass, its centre of mass and the friction of the gels on
    it are not told. Actions raise the gripper and change its width. From the start of env step 8 to the end of env step
    16 a load grows on the part, which has to hang clear of the table meanwhile. Then it is to be set down upright and
    let go. Actions outside -1 to 1 are clipped. World frame: z up, origin on the table below the part's middle.

    The grid of `marker_flow` is drawn again at every observation. Contacts are those of `arena-2`.

    Reset options: `shape` ("block", "bar", "column"), `offset_mm` (x, z: where it is grasped, from 30 mm above the
    middle of its lower face), and `rng_seed`, the integers that seed the episode's generator in place of the
    environment's own. What is left open is drawn: the shape, x within 1.5 mm and z within 3 mm.

    Ends: terminated by success (`end_reason` "success"); truncated by a jaw that crushes the part, as it presses with
    more than 1.5 times the force that is needed for all of the load ("force"); by a sensing surface that moved more
    than 1.5 mm ("tactile"); by a part that is not clear of the table while the load grows, or that slides down in the
    grasp by more than 1.5 mm in an env step ("error"); by 28 env steps ("steps"), or physics that did not converge
    ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `SlipSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = SlipSettings
    scene_type: ClassVar = SlipScene
    shape_type: ClassVar = SlipShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [*map(part_mesh, SlipShape), table_mesh()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: SlipSettings
    ) -> SlipStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x and z."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            x, z = random.uniform(-1.0, 1.0, 2).tolist()
            return SlipStart(shape=shape, x_mm=x * settings.random_x_mm, z_mm=z * settings.random_z_mm)
        expected = f"expected (x, z) in mm within {LARGEST_X_MM:g} and {LARGEST_Z_MM:g} mm either way"
        x_mm, z_mm = numbers(self.env_id, OFFSET, wanted, either_way(LARGEST_X_MM, LARGEST_Z_MM), expected)
        return SlipStart(shape=shape, x_mm=x_mm, z_mm=z_mm)

    def _error(self) -> float:
        scene = self.task_scene
        heights_mm = scene.heights_mm()
        if scene.env_steps < self.settings.load_last_step:
            return max(0.0, LIFTED_MM - float(heights_mm.min()))
        return float(heights_mm.max()) + scene.grasped.grip_force_n() / scene.largest_grip_n

    def _judge(self) -> Flags:
        scene, settings = self.task_scene, self.settings
        crushed = scene.grasped.peak_grip_force_n() > scene.largest_grip_n
        heights_mm = scene.heights_mm()
        dropped = scene.fallen_mm > LARGEST_FALL_MM or (scene.is_loading and bool((heights_mm < CLEAR_MM).any()))
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        stands = bool((heights_mm < STANDING_MM).all()) and scene.grasped.grip_force_n() < FREE_N
        return Flags(
            force_too_large=crushed,
            tactile_movement_too_large=tactile,
            error_too_large=dropped,
            too_many_steps=scene.env_steps >= settings.max_steps,
            is_success=stands and scene.env_steps > settings.load_last_step and not (crushed or tactile or dropped),
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        scene, settings = self.task_scene, self.settings
        strain = scene.grasped.grip_force_n() / scene.largest_grip_n
        reward = progress - settings.step_penalty * (1.0 + strain)
        if flags.has_failed:
            return reward - settings.failure_penalty
        return reward + (settings.final_reward if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "crushed": flags.force_too_large,
            "heights_mm": scene.heights_mm(),
            "relative_motion_mm": scene.relative_motion_mm(),
            "gripper_width_mm": 1e3 * scene.grasped.gripper_width_m,
            "load_n": float(scene.load_n()[0]),
            "grip_force_n": scene.grasped.grip_force_n(),
            "mean_grip_force_n": scene.mean_grip_force_n,
            "needed_grip_n": scene.needed_grip_n(),
            "largest_grip_n": scene.largest_grip_n,
            "is_loaded": scene.env_steps >= self.settings.load_last_step,
            "is_success": flags.is_success,
        }


# Of the force that friction needs, and of the way between two forces in an env step.
_MARGIN, _STIFFNESS_N_MM = 1.25, 30.0
# Grips of the env steps until the part hangs, each half as much again, the lift meanwhile, and from where on it hangs.
_GRIPS_N = (1.0, 1.5, 2.25, 3.375, 5.0625, 7.59375, 11.390625, 17.0859375)
_LIFT_MM, _HANGING_MM = 0.6, 0.3


def lift_ever_harder(_: Observation, info: Info) -> ActionArray:
    """Lift ever harder until the part hangs, grip a quarter harder than friction needs, and set down and let go.

    Who imitates this feels what the weight and the friction are.
    """
    lowest_mm, grip_n = info["heights_mm"].min(), info["grip_force_n"]
    wanted_n = _MARGIN * info["needed_grip_n"]
    up_mm, wider_mm = 0.0, min(0.0, (grip_n - wanted_n) / _STIFFNESS_N_MM)
    if info["is_loaded"]:
        up_mm = -min(1.0, lowest_mm)
        if lowest_mm < 0.5 * STANDING_MM:  # A part that leans rights itself once it is let go.
            up_mm, wider_mm = 0.0, 0.2
    elif lowest_mm < _HANGING_MM and info["load_n"] == 0.0:
        wanted_n = _GRIPS_N[min(info["steps"], len(_GRIPS_N) - 1)]
        up_mm, wider_mm = _LIFT_MM, (grip_n - wanted_n) / _STIFFNESS_N_MM
    elif grip_n > 0.9 * wanted_n:
        up_mm = min(1.0, max(0.0, LIFTED_MM - lowest_mm))
    action = np.array([up_mm, wider_mm]) / np.array(TASK.action_scale)
    return np.asarray(np.clip(action, -1.0, 1.0), dtype=np.float32)
