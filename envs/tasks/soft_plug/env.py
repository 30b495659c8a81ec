"""`ViTac/SoftPlug-v1`, `ViTac/CableEnd-v1`: push an elastic plug, or a connector on a soft boot, into a hole.

First their scene: an elastic part between two gels, above a plate with a hole for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import PART_MATERIAL, GelBody, GelMesh, PronyBranch, SurfaceMesh
from ...geometry.solid import Face, at_height, rectangle, solid_from_faces, walls_between
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from ...scene.perspective import ActionArray
from ...tactile.gel import GelCells, GelDimensions, highest_mm, structured_gel
from ...tactile.markers import MarkerSettings
from ..definition import Flags, surface_moved_too_far
from ..quantities import check_quantities
from ..settings import SHAPE, arena_physics, choose_shape, either_way, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import CABLE_TASK, INTERFERENCE, MODULUS, PLUG_QUANTITIES, PLUG_TASK, SUCCESS_DEPTH_MM

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


PLUG_HEIGHT_MM = 38.0
CELLS = GelCells(x=3, y=3, bevel=0, layers=10, is_hexahedral=True)
# Of the square cross-section: 0 has sharp corners, 1 would be a circle.
ROUNDNESS = 0.5
POISSON_RATIO, DENSITY_KG_M3 = 0.45, 1100.0
PLATE_MM = rectangle(-30.0, 30.0, -30.0, 30.0)
PLATE_THICKNESS_MM = 10.0
# The hole is wider than the plug at the rim, and narrows down to its own width over this depth.
MOUTH_MM, MOUTH_DEPTH_MM = 1.0, 2.0
# Free space below the plug and beside the gels when the scene is built.
START_GAP_MM, GRASP_GAP_MM = 0.6, 0.1
GRASP_STEPS = 2


class PlugShape(StrEnum):
    """Width of the plug, a square with rounded corners."""

    STOPPER = "stopper"
    """10 mm."""
    SLIM = "slim"
    """8.5 mm, which buckles under half of the force."""


class CableShape(StrEnum):
    """What is at the end of a cable."""

    CABLE = "cable"
    """A hard connector of 8.5 mm in a boot of rubber, which is held and has a neck of 3 mm below that."""


class PlugForm(NamedTuple):
    """Sides of a plug's cross-sections along its axis, squares with rounded corners.

    Attributes:
        width_mm: of its lower end, and of where it is held.
        grasp_mm: height at which the gripper holds it.
        levels_mm: height and width at each level of nodes; none for a straight plug with levels at equal distances.
        hard_layers: layers of hexahedra that are hard, from the lower end.
        neck: levels whose sideways motion is bending too, beside that of the lower end.
        viscosity: of the rubber.
    """

    width_mm: float
    grasp_mm: float
    levels_mm: tuple[tuple[float, float], ...] = ()
    hard_layers: int = 0
    neck: range = range(0)
    viscosity: tuple[PronyBranch, ...] = ()


# The gels' rows of nodes are 0, 1.6, 3.6, 6.2 and 9.6 mm above and below the grasp. No level of nodes is near one of
# them: there contacts change from one side of an edge to the other and back while the solver iterates.
FORMS: dict[PlugShape | CableShape, PlugForm] = {
    PlugShape.STOPPER: PlugForm(10.0, 26.0),
    PlugShape.SLIM: PlugForm(8.5, 26.0),
    CableShape.CABLE: PlugForm(
        8.5,
        31.9,
        levels_mm=(
            *((0.0, 8.5), (3.25, 8.5), (6.5, 8.5)),
            *((8.0 + layer, 3.0) for layer in range(13)),
            *((21.5, 8.5), (27.0, 8.5), (32.7, 8.5), (36.8, 8.5), (42.3, 8.5)),
        ),
        hard_layers=3,
        neck=range(3, 16),
        # Without it the neck snaps aside within one IPC step, far from the balance that Newton's method starts from.
        viscosity=(PronyBranch(modulus_ratio=1.0, relaxation_time_s=0.3),),
    ),
}
# Young's modulus of hard layers, in those of the rubber.
HARDNESS = 50.0


@dataclass(frozen=True, kw_only=True)
class SoftPlugSettings:
    """What the task leaves open.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        ipc_steps: of an env step.
        action_scale_mm: motion at an action of 1: x, y, z.
        indentation_mm: how far each gel is pressed into the plug, or the plug into it.
        plug_modulus_mpa: Young's modulus of the plug.
        interference_mm: by how much the hole is narrower than the plug on each side.
        largest_bend_mm: sideways motion of the plug's lower end beyond which it has buckled.
        step_penalty: of an env step in the reward.
        final_reward: of success.
        failure_penalty: of the flags that end an episode.
        random_xy_mm: largest |x| and |y| of a random start.
        physics: materials and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 24
    ipc_steps: int = 4
    action_scale_mm: tuple[float, ...] = PLUG_TASK.action_scale
    indentation_mm: float = 0.6
    plug_modulus_mpa: float = MODULUS.nominal
    interference_mm: float = INTERFERENCE.nominal
    largest_bend_mm: float = 1.5
    step_penalty: float = 0.1
    final_reward: float = 10.0
    failure_penalty: float = 10.0
    random_xy_mm: float = 3.0
    physics: PhysicsSettings = field(default_factory=arena_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        require(1 <= self.ipc_steps <= 100, "ipc_steps", self.ipc_steps, "1 to 100")
        scale = self.action_scale_mm
        usable = len(scale) == len(PLUG_TASK.actions) and all(0 <= value <= 5 for value in scale)
        require(usable, "action_scale_mm", scale, "three numbers of 0 to 5")
        require(0 < self.indentation_mm <= 2, "indentation_mm", self.indentation_mm, "0 to 2 mm, half the gel")
        check_quantities(self, PLUG_QUANTITIES)
        require(self.largest_bend_mm > 0, "largest_bend_mm", self.largest_bend_mm, "more than 0 mm")
        require(1.3 <= self.random_xy_mm <= 8, "random_xy_mm", self.random_xy_mm, "1.3 to 8 mm")


@dataclass(frozen=True, kw_only=True)
class CableEndSettings(SoftPlugSettings):
    """Those of the soft plug, with a hole that is wider than the connector."""

    max_steps: int = 20
    plug_modulus_mpa: float = 5.0
    interference_mm: float = -0.2
    largest_bend_mm: float = 2.0


@dataclass(frozen=True, kw_only=True)
class SoftPlugStart:
    """Start of an episode.

    Attributes:
        shape: of the plug.
        x_mm: plug beside its hole.
        y_mm: plug beside its hole.
    """

    shape: PlugShape | CableShape
    x_mm: float
    y_mm: float


def plug_mesh(shape: PlugShape | CableShape) -> GelMesh:
    """Return the plug of this shape, its lower face at z = 0 and its axis along z."""
    form = FORMS[shape]
    size = GelDimensions(
        length_mm=form.width_mm,
        width_mm=form.width_mm,
        thickness_mm=PLUG_HEIGHT_MM,
        bevel_height_mm=0.0,
        bevel_inset_mm=0.0,
    )
    cells = replace(CELLS, layers=len(form.levels_mm) - 1) if form.levels_mm else CELLS
    box = structured_gel(name=f"{shape} plug", size=size, cells=cells)
    rest_m, half_m = box.rest_position_m.copy(), 0.5e-3 * form.width_mm
    across = rest_m[:, :2] / half_m
    # Squares become circles where the roundness is 1 (Nowell 2005).
    rest_m[:, :2] *= np.sqrt(1.0 - 0.5 * ROUNDNESS * across[:, ::-1] * across[:, ::-1])
    rest_m[:, 2] -= rest_m[:, 2].min()
    for nodes_m, (height_mm, width_mm) in zip(np.split(rest_m, cells.layers + 1), form.levels_mm, strict=False):
        nodes_m[:, :2] *= width_mm / form.width_mm
        nodes_m[:, 2] = 1e-3 * height_mm
    return replace(box, rest_position_m=rest_m).released()


def stiffening(shape: PlugShape | CableShape, mesh: GelMesh) -> FloatArray | None:
    """Return by how much the cells of a plug are stiffer than its rubber, shape [c]; None where none is."""
    hard_layers, layer = FORMS[shape].hard_layers, np.arange(len(mesh.hexahedra)) // (CELLS.x * CELLS.y)
    return np.where(layer < hard_layers, HARDNESS, 1.0) if hard_layers else None


def plate_mesh(shape: PlugShape | CableShape, interference_mm: float) -> SurfaceMesh:
    """Return the plate with the hole for a plug, its rim at z = 0."""
    half_mm = 0.5 * FORMS[shape].width_mm - interference_mm
    wide_mm = 0.5 * FORMS[shape].width_mm + MOUTH_MM
    loops = [
        at_height(rectangle(-half, half, -half, half), z_mm)
        for half, z_mm in ((wide_mm, 0.0), (half_mm, -MOUTH_DEPTH_MM), (half_mm, -PLATE_THICKNESS_MM))
    ]
    top, bottom = at_height(PLATE_MM, 0.0), at_height(PLATE_MM, -PLATE_THICKNESS_MM)
    faces = [
        Face(outline_mm=top, holes_mm=(loops[0],)),
        Face(outline_mm=bottom[::-1], holes_mm=(loops[2],)),
        *walls_between(bottom, top),
        *walls_between(loops[1][::-1], loops[0][::-1]),
        *walls_between(loops[2][::-1], loops[1][::-1]),
    ]
    return solid_from_faces(faces, "plate")


class SoftPlugScene:
    """A plug between the gels above its hole, and the motions of the gripper.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        shape: of the plug.
        measured_vertices: corners of its lower face.
        largest_bend_mm: of the plug at the ends of the env steps so far.
    """

    def __init__(self, *, start: SoftPlugStart, meshes: Meshes, settings: SoftPlugSettings, clocks: Clocks) -> None:
        self.shape, self.env_steps, self.largest_bend_mm = start.shape, 0, 0.0
        self._settings = settings
        self._start_mm = np.array([start.x_mm, start.y_mm, START_GAP_MM])
        gel, plug, form = meshes.gel(), plug_mesh(start.shape), FORMS[start.shape]
        pose = GripperPose(
            x_m=1e-3 * start.x_mm,
            y_m=1e-3 * start.y_mm,
            z_m=1e-3 * (START_GAP_MM + form.grasp_mm),
            angle_rad=0.0,
            half_opening_m=1e-3 * (0.5 * form.width_mm + highest_mm(gel) + GRASP_GAP_MM),
        )
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=gel, pose=pose),
            held=GelBody(
                mesh=plug,
                rotation=np.eye(3),
                translation_m=1e-3 * self._start_mm,
                youngs_modulus_pa=1e6 * settings.plug_modulus_mpa,
                poisson_ratio=POISSON_RATIO,
                density_kg_m3=DENSITY_KG_M3,
                stiffening=stiffening(start.shape, plug),
                viscosity=form.viscosity,
                material=PART_MATERIAL,
            ),
            fixed=fixed_at_origin(plate_mesh(start.shape, settings.interference_mm), friction=0.5),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )
        rest_m = self.grasped.held_surface.vertices_m
        self._lower_face = np.flatnonzero(rest_m[:, 2] == 0.0)
        self._neck = [np.flatnonzero(rest_m[:, 2] == 1e-3 * form.levels_mm[level][0]) for level in form.neck]
        across = np.abs(rest_m[:, :2]).min(axis=1)
        self.measured_vertices = self._lower_face[across[self._lower_face] == across[self._lower_face].max()]
        self._start_pose = pose

    def grasp(self) -> None:
        """Close on the plug in free air, and take the references."""
        closing_m = 1e-3 * (GRASP_GAP_MM + self._settings.indentation_mm)
        self.grasped.move_to(self._start_pose.moved(closing_m=closing_m), ipc_steps=GRASP_STEPS)
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        """Move the gripper as an action says."""
        x_mm, y_mm, z_mm = (np.clip(command, -1.0, 1.0) * np.array(self._settings.action_scale_mm)).tolist()
        goal = self.grasped.pose.moved(x_m=1e-3 * x_mm, y_m=1e-3 * y_mm, z_m=1e-3 * z_mm)
        self.grasped.move_to(goal, ipc_steps=self._settings.ipc_steps)
        self.largest_bend_mm = max(self.largest_bend_mm, self.bend_mm())

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded motion of the gripper since the start [mm], shape [3]."""
        pose, start = self.grasped.pose, self._start_pose
        return 1e3 * np.array([pose.x_m - start.x_m, pose.y_m - start.y_m, pose.z_m - start.z_m])

    def offset_mm(self) -> FloatArray:
        """Return where the gripper holds the plug beside its hole [mm], shape [2]."""
        return 1e3 * np.array([self.grasped.pose.x_m, self.grasped.pose.y_m])

    def heights_mm(self) -> FloatArray:
        """Return the heights of the corners of the plug's lower face above the rim [mm], shape [4]."""
        return 1e3 * self.grasped.held_vertices_m(self.measured_vertices)[:, 2]

    def lower_end_mm(self) -> FloatArray:
        """Return the middle of the plug's lower face [mm], shape [3]."""
        return self._middle_mm(self._lower_face)

    def bend_mm(self) -> float:
        """Return how far the plug's lower end or its neck is beside where the gripper holds it [mm]."""
        aside_mm = [self._middle_mm(level)[:2] - self.offset_mm() for level in (self._lower_face, *self._neck)]
        return max(float(np.sqrt(x * x + y * y)) for x, y in aside_mm)

    def _middle_mm(self, vertices: IndexArray) -> FloatArray:
        points: list[list[float]] = (1e3 * self.grasped.held_vertices_m(vertices)).tolist()
        return np.array([sum(column) / len(points) for column in zip(*points, strict=True)])


OFFSET = "offset_mm"
LARGEST_XY_MM = 8.0
LEAST_MM = 1.2
"""Least |x| or |y| of a random start: the plug then does not just slide in."""


class SoftPlugEnv(TactileTaskEnv[SoftPlugScene, SoftPlugSettings]):
    """Push an elastic plug into a tight hole by touch alone, without crushing it or letting it buckle.

    Two gels hold a plug of rubber by its upper part. Below it is a plate with a hole that is narrower than the plug,
    with a wider mouth, a few millimetres beside it. Pressed on the plate the plug shortens, bends and slides; inside
    the hole its walls press on it. The policy moves the gripper along x, y and z. World frame: z up, origin in the
    middle of the hole's rim, y from jaw to jaw. Actions outside -1 to 1 are clipped. Contacts are those of `arena-2`.

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("stopper", "slim"), `offset_mm` (x, y of plug and gripper from the hole), and `rng_seed`,
    the integers that seed the episode's generator in place of the environment's own. What is left open is drawn: the
    shape, then x and y within 3 mm, one of them at least 1.2 mm.

    Ends: terminated by success, as soon as all corners of the plug's lower face are 4 mm below the rim (`end_reason`
    "success"); truncated by a force on the plug beyond `force_limit_n`, if that is given ("force"); by a sensing
    surface that moved more than 1.5 mm ("tactile"); by a lower end that is more than 1.5 mm beside where the gripper
    holds the plug, which has buckled, or a gripper more than 8 mm beside the hole ("error"); by 24 env steps ("steps"),
    or physics that did not converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `SoftPlugSettings`.
    """

    task: ClassVar = PLUG_TASK
    settings_type: ClassVar = SoftPlugSettings
    scene_type: ClassVar = SoftPlugScene
    shape_type: ClassVar[type[PlugShape | CableShape]] = PlugShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [plate_mesh(shape, self.settings.interference_mm) for shape in self.shape_type]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: SoftPlugSettings
    ) -> SoftPlugStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x and y."""
        shape = choose_shape(self.env_id, options, self._shapes, random)
        drawn = [0.0, 0.0]
        while not accepts_start(shape, drawn):
            drawn = (settings.random_xy_mm * random.uniform(-1.0, 1.0, 2)).tolist()
        wanted, ranges = options.get(OFFSET, drawn), either_way(LARGEST_XY_MM, LARGEST_XY_MM)
        expected = f"expected (x, y) in mm within {LARGEST_XY_MM:g} mm either way"
        x_mm, y_mm = numbers(self.env_id, OFFSET, wanted, ranges, expected)
        return SoftPlugStart(shape=shape, x_mm=x_mm, y_mm=y_mm)

    def _error(self) -> float:
        scene = self.task_scene
        x, y = scene.offset_mm().tolist()
        return float(np.sqrt(x * x + y * y)) + max(0.0, float(scene.heights_mm().max()) + SUCCESS_DEPTH_MM)

    def _judge(self) -> Flags:
        scene, settings = self.task_scene, self.settings
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        buckled = scene.bend_mm() > settings.largest_bend_mm
        left = bool((np.abs(scene.offset_mm()) > LARGEST_XY_MM).any())
        is_in = bool((scene.heights_mm() < -SUCCESS_DEPTH_MM).all())
        return Flags(
            tactile_movement_too_large=tactile,
            error_too_large=buckled or left,
            too_many_steps=scene.env_steps >= settings.max_steps,
            is_success=is_in and not (tactile or buckled or left),
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        settings = self.settings
        reward = progress - settings.step_penalty
        if flags.has_failed:
            return reward - settings.failure_penalty
        return reward + (settings.final_reward if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "heights_mm": scene.heights_mm(),
            "bend_mm": scene.bend_mm(),
            "largest_bend_mm": scene.largest_bend_mm,
            "gt_offset_mm": scene.offset_mm(),
            "relative_motion_mm": scene.relative_motion_mm(),
            "is_success": flags.is_success,
        }


class CableEndEnv(SoftPlugEnv):
    """Push a cable's connector into its hole by touch alone, without crushing it or letting its boot buckle.

    As `ViTac/SoftPlug-v1`, from which it differs so: what is held is a boot of rubber, whose neck of 3 mm carries a
    hard connector, and the hole is wider than the connector. Pressed on the plate the neck bends or buckles.

    Reset options: `shape` ("cable"), `offset_mm` (x, y of connector and gripper from the hole), and `rng_seed`.

    Ends: as `ViTac/SoftPlug-v1`; the boot has buckled where the connector's lower end or the boot's neck is more than
    2 mm beside where the gripper holds it; 20 env steps.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `CableEndSettings`.
    """

    task: ClassVar = CABLE_TASK
    settings_type: ClassVar = CableEndSettings
    shape_type: ClassVar = CableShape


def accepts_start(_: str, offset_mm: Sequence[float]) -> bool:
    """Return whether an episode may start there: the plug must not just slide in."""
    return max(map(abs, offset_mm)) >= LEAST_MM


# Beside the hole, where its mouth still catches the plug; where the gripper goes to touch the plate, and above the rim.
_OVER_MM, _TOUCHING_MM, _ABOVE_MM = 0.5, -1.4, 0.3
# Env steps of a touch, and of it with the way that follows.
_TOUCH_STEPS, _CYCLE_STEPS = 2, 5


def touch_then_push(_: Observation, info: Info) -> ActionArray:
    """Touch the plate, go over the hole above it, and push; where that is beside the hole, it is the next touch.

    Who imitates this feels where the hole is, as often as it takes.
    """
    aside_mm = -info["gt_offset_mm"]
    if float(np.abs(aside_mm).max()) <= _OVER_MM:
        motion_mm = np.append(aside_mm, -1.0)
    elif info["steps"] % _CYCLE_STEPS < _TOUCH_STEPS:
        motion_mm = np.array([0.0, 0.0, _TOUCHING_MM - info["relative_motion_mm"][2]])
    else:
        motion_mm = np.append(aside_mm, max(0.0, _ABOVE_MM - info["heights_mm"].min()))
    return np.asarray(np.clip(motion_mm / np.array(PLUG_TASK.action_scale), -1.0, 1.0), dtype=np.float32)
