"""`ViTac/LockOpening-v1`: align a key in its lock and lift it, holding it between two tactile sensors.

First its scene: settings, parts, and motions of the key, its handle held by two gels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import GelMesh, RigidBody, SurfaceMesh
from ...fem.model.settings import ContactSettings
from ...geometry.keys_and_locks import (
    KEY_HALF_THICKNESS_MM,
    OWN_CLEARANCE,
    KeyShape,
    key_control_points,
    key_surface,
    lock_control_points,
    lock_surface,
)
from ...geometry.solid import nearest_vertices
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import Gripper, GripperPose, SensorMount, ipc_steps
from ...scene.perspective import ActionArray, longest_action
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import Flags
from ..quantities import check_quantities
from ..settings import SHAPE, choose_shape, either_way, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import (
    CEILING_Z_M,
    GRIP_QUANTITIES,
    GRIPPER_X,
    GRIPPER_Z,
    SLOT_CLEARANCE,
    SUCCESS_Z_RANGE_M,
    TASK,
    LockState,
    alignment_error,
    judge_flags,
    reward,
)


def lock_physics() -> PhysicsSettings:
    """Return the time step and friction smoothing of the lock task; the rest as in the peg task."""
    return PhysicsSettings(time_step_s=0.2, contact=ContactSettings(friction_velocity_m_s=1e-3))


TRAINING_RANGES = {
    "physics.gel_friction": (50.0, 125.0),
    "key_friction": (0.2, 1.0),
    "lock_friction": (0.0, 1.0),
    "indentation_mm": (0.5, 1.25),
}
"""Ranges of the published training."""


@dataclass(frozen=True, kw_only=True)
class LockOpeningSettings:
    """What the task leaves open; lengths in mm are the challenge's own interface.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        action_scale_mm: motion at an action of 1: x [mm], z [mm].
        step_penalty: P in the reward.
        final_reward: reward of success.
        failure_penalty: cost of the force, tactile or error flag.
        indentation_mm: how far each gel is pressed into the key.
        gripper_x_mm: grasp centre beside its nominal place on the handle, outwards; the jitter is added.
        gripper_z_mm: the same upwards.
        slot_clearance_mm: room of a tooth in its slot on both sides; 0 for that of the challenge's lock, which is 2 mm,
            and 1 mm for key3.
        key_friction: friction coefficient of the key.
        lock_friction: friction coefficient of the lock.
        random_x_mm: largest x of a random start.
        jitter_mm: largest displacement of the sensors along the key, and up or down.
        reference_quirks: reproduce the jump of `relative_motion` after the first env step of the 2025 code, which
            tells the keys apart.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    action_count: ClassVar[int] = len(TASK.actions)

    max_steps: int = 50
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 1.0
    final_reward: float = 10.0
    failure_penalty: float = 5.0
    indentation_mm: float = 0.875
    gripper_x_mm: float = GRIPPER_X.nominal
    gripper_z_mm: float = GRIPPER_Z.nominal
    slot_clearance_mm: float = OWN_CLEARANCE
    key_friction: float = 0.6
    lock_friction: float = 0.5
    random_x_mm: float = 5.0
    jitter_mm: float = 2.0
    reference_quirks: bool = False
    physics: PhysicsSettings = field(default_factory=lock_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        scale = self.action_scale_mm
        usable = len(scale) == self.action_count and all(isfinite(value) and 0 <= value <= 10 for value in scale)
        require(usable, "action_scale_mm", scale, f"{self.action_count} numbers of 0 to 10")
        require(0 < self.indentation_mm <= 2, "indentation_mm", self.indentation_mm, "0 to 2 mm, half the gel")
        check_quantities(self, GRIP_QUANTITIES)
        if self.slot_clearance_mm != OWN_CLEARANCE:
            check_quantities(self, (SLOT_CLEARANCE,))
        for name in ("key_friction", "lock_friction"):
            require(0 <= getattr(self, name) <= 1e3, name, getattr(self, name), "0 to 1000")
        require(0 <= self.random_x_mm <= 20, "random_x_mm", self.random_x_mm, "0 to 20 mm")
        require(0 <= self.jitter_mm <= 4, "jitter_mm", self.jitter_mm, "0 to 4 mm")


def key_mesh(meshes: Meshes, shape: KeyShape) -> SurfaceMesh:
    """Return the key of this shape."""
    return meshes.part(lambda: key_surface(shape), f"key_lock/{shape}.STL")


def lock_mesh(meshes: Meshes, shape: KeyShape, slot_clearance_mm: float = OWN_CLEARANCE) -> SurfaceMesh:
    """Return the lock for this key; the challenge has files of its own clearance only."""
    if slot_clearance_mm != OWN_CLEARANCE:
        return lock_surface(shape, slot_clearance_mm)
    number = list(KeyShape).index(shape) + 1
    return meshes.part(lambda: lock_surface(shape), f"key_lock/lock_core_sim{number}.STL")


@dataclass(frozen=True, kw_only=True)
class KeyOffset:
    """Where the key stands at the start, relative to 6.5 mm inside its lock.

    Attributes:
        x_mm: outwards [mm].
        y_mm: sideways [mm].
        z_mm: upwards [mm].
    """

    x_mm: float
    y_mm: float
    z_mm: float


@dataclass(frozen=True, kw_only=True)
class SensorJitter:
    """Displacement of both sensors from their nominal place on the key.

    Attributes:
        x_mm: outwards [mm].
        z_mm: upwards [mm].
    """

    x_mm: float
    z_mm: float


@dataclass(frozen=True, kw_only=True)
class LockStart:
    """Start of an episode."""

    shape: KeyShape
    offset: KeyOffset
    jitter: SensorJitter


FloatArray = NDArray[np.float64]


# Key tip at the start, before the offset; 6.5 mm deeper than where the teeth stand below their slots.
START_X_MM = 6.5
START_GAP_MM = 0.5
GRASP_HEIGHT_MM = 16.0
SPEED_M_S = 2e-3
# Distance of the sensors from the key's tip.
SENSOR_X_MM = {KeyShape.KEY1: 70.0, KeyShape.KEY2: 75.0, KeyShape.KEY3: 70.0, KeyShape.KEY4: 80.0}


# Where the 2025 code records the grasp to be on every key, instead of at the sensors [mm from the tip].
_RECORDED_GRASP_X_MM = 49.5
_POINT_SCALE_PER_M = 200.0
# Both gels' x axes point outwards along the key; the left one looks along +y, the right one along -y.
MOUNTS = (
    SensorMount(side=-1, rotation=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])),
    SensorMount(side=1, rotation=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class KeyVertices:
    """Vertices of the key's surface that are measured, each of shape [4]."""

    rear_tooth: NDArray[np.int64]
    front_tooth: NDArray[np.int64]
    tip: NDArray[np.int64]


class LockScene:
    """A lock scene and the gripper motions of the task.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        shape: of key and lock.
    """

    def __init__(self, *, start: LockStart, meshes: Meshes, settings: LockOpeningSettings, clocks: Clocks) -> None:
        self._settings = settings
        self.shape = start.shape
        self.env_steps = 0
        key = key_mesh(meshes, start.shape)
        points = key_control_points(start.shape)
        self._vertices = KeyVertices(
            rear_tooth=nearest_vertices(key, points.rear_tooth_m),
            front_tooth=nearest_vertices(key, points.front_tooth_m),
            tip=nearest_vertices(key, points.tip_m),
        )
        self._lock_points = lock_control_points(start.shape, settings.slot_clearance_mm)
        position_m = self._key_position_m(start)
        self._grasp_pose = _open_pose(start, position_m, settings, meshes.gel())
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=MOUNTS, gel=meshes.gel(), pose=self._grasp_pose),
            held=RigidBody(
                mesh=key,
                rotation=np.eye(3),
                translation_m=position_m,
                density_kg_m3=settings.physics.rigid_density_kg_m3,
                friction=settings.key_friction,
            ),
            fixed=fixed_at_origin(
                lock_mesh(meshes, start.shape, settings.slot_clearance_mm), friction=settings.lock_friction
            ),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Close on the key's handle and take the references."""
        closing_m = (START_GAP_MM + self._settings.indentation_mm) * 1e-3
        goal = self.grasped.pose.moved(closing_m=closing_m)
        self.grasped.move_to(goal, ipc_steps=self._ipc_steps(closing_m))
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        """Move the gripper as an action says, into the lock and down."""
        inwards_mm, down_mm = (np.clip(command, -1.0, 1.0) * np.array(self._settings.action_scale_mm)).tolist()
        self.travel(-inwards_mm, -down_mm)

    def travel(self, x_mm: float, z_mm: float, y_mm: float = 0.0) -> None:
        """Move the gripper by x, z and y [mm], all together."""
        longest_m = max(abs(x_mm), abs(y_mm), abs(z_mm)) * 1e-3
        goal = self.grasped.pose.moved(x_m=x_mm * 1e-3, y_m=y_mm * 1e-3, z_m=z_mm * 1e-3)
        self.grasped.move_to(goal, ipc_steps=self._ipc_steps(longest_m))

    def relative_motion_mm(self) -> FloatArray:
        """Return the motion of the gripper's centre since the start [mm], shape [3].

        The 2025 code measures from a wrong grasp centre after the first env step, so that x jumps by 20.5, 25.5, 20.5
        or 30.5 mm and gives the key away; only `reference_quirks` does so here.
        """
        now, first = self.grasped.pose, self._grasp_pose
        motion_mm = np.array([now.x_m - first.x_m, now.y_m - first.y_m, now.z_m - first.z_m]) * 1e3
        if self._settings.reference_quirks and self.env_steps > 0:
            motion_mm[0] += SENSOR_X_MM[self.shape] - _RECORDED_GRASP_X_MM
        return motion_mm

    def state(self) -> LockState:
        """Return the measured points and surface motion, in arrays of their own."""
        return LockState(
            env_steps=self.env_steps,
            rear_tooth_m=self.grasped.held_vertices_m(self._vertices.rear_tooth),
            front_tooth_m=self.grasped.held_vertices_m(self._vertices.front_tooth),
            rear_slot_m=self.rear_slot_m(),
            front_slot_m=self.front_slot_m(),
            entrance_m=self.entrance_m(),
            surface_diff_m=self.grasped.surface_diff_m(),
        )

    @property
    def measured_vertices(self) -> NDArray[np.int64]:
        """Vertices of the key whose heights are measured: of its rear tooth, then of the front one."""
        return np.concatenate([self._vertices.rear_tooth, self._vertices.front_tooth])

    def rear_slot_m(self) -> FloatArray:
        """Return the lower corners of the slot for the rear tooth [m], shape [4, 3]."""
        return self._lock_points.rear_slot_m.copy()

    def front_slot_m(self) -> FloatArray:
        """Return the lower corners of the slot for the front tooth [m], shape [4, 3]."""
        return self._lock_points.front_slot_m.copy()

    def entrance_m(self) -> FloatArray:
        """Return the corners of the lock's entrance face [m], shape [4, 3]."""
        return self._lock_points.entrance_m.copy()

    def rear_tooth_from_slot(self) -> FloatArray:
        """Return the mean corner of the rear tooth from its slot [5 mm], shape [3]; see `_tooth_from_slot`."""
        return _tooth_from_slot(self.grasped.held_vertices_m(self._vertices.rear_tooth), self.rear_slot_m())

    def front_tooth_from_slot(self) -> FloatArray:
        """Return the mean corner of the front tooth from its slot [5 mm], shape [3]; see `_tooth_from_slot`."""
        return _tooth_from_slot(self.grasped.held_vertices_m(self._vertices.front_tooth), self.front_slot_m())

    def tip_m(self) -> FloatArray:
        """Return the corners of the key's tip in the world [m], shape [4, 3]."""
        return self.grasped.held_vertices_m(self._vertices.tip)

    def _ipc_steps(self, distance_m: float) -> int:
        return ipc_steps(distance_m, speed_per_s=SPEED_M_S, time_step_s=self._settings.physics.time_step_s)

    def _key_position_m(self, start: LockStart) -> FloatArray:
        """Return where the key's origin is at the start [m], shape [3]."""
        offset = start.offset
        return np.array([START_X_MM + offset.x_mm, offset.y_mm, offset.z_mm]) * 1e-3


def _open_pose(start: LockStart, position_m: FloatArray, settings: LockOpeningSettings, gel: GelMesh) -> GripperPose:
    """Return the pose of the open gripper around the key's handle, off by the jitter and as the settings say."""
    x_m, y_m, z_m = position_m.tolist()
    return GripperPose(
        x_m=x_m + (SENSOR_X_MM[start.shape] + start.jitter.x_mm + settings.gripper_x_mm) * 1e-3,
        y_m=y_m,
        z_m=z_m + (GRASP_HEIGHT_MM + start.jitter.z_mm + settings.gripper_z_mm) * 1e-3,
        angle_rad=0.0,
        half_opening_m=(KEY_HALF_THICKNESS_MM + highest_mm(gel) + START_GAP_MM) * 1e-3,
    )


def _tooth_from_slot(tooth_m: FloatArray, slot_m: FloatArray) -> FloatArray:
    """Return the mean tooth corner from its slot [5 mm]: x from the slot's middle, y, z from the ceiling."""
    tooth = tooth_m.sum(axis=0) / len(tooth_m)
    slot_x_m = slot_m[:, 0].sum() / len(slot_m)
    return np.asarray(_POINT_SCALE_PER_M * (tooth - np.array([slot_x_m, 0.0, CEILING_Z_M])))


OFFSET, JITTER = "offset_mm", "sensor_jitter_mm"


# A start at which the key's tip is clear of the end wall and its shaft and teeth of floor, ceiling and walls.
X_RANGE_MM = (-1.4, 40.0)
LARGEST_Y_MM = 0.8
LARGEST_Z_MM = 0.8
LARGEST_JITTER_MM = 4.0


class LockInfo(TypedDict):
    """The challenge's entries, in the order of its logs; the base adds how the episode ended.

    Points are in the world [m], each of shape [4, 3].

    Attributes:
        steps: env steps played so far.
        key1_pts_m: top corners of the key's rear measured tooth.
        key2_pts_m: top corners of the front measured tooth.
        key_side_pts_m: corners of the key's tip.
        lock1_pts_m: lower corners of the slot for the rear tooth.
        lock2_pts_m: lower corners of the slot for the front tooth.
        lock_side_pts_m: corners of the lock's entrance face.
        surface_diff_m: mean motion of the left and the right sensing surface since the grasp [m], shape [2].
        tactile_movement_too_large: one of them is more than the task allows.
        relative_motion_mm: motion of the gripper (x, y, z) since the reset [mm], shape [3].
        error_too_large: a tooth is far out of place.
        is_success: the task is solved.
    """

    steps: int
    key1_pts_m: FloatArray
    key2_pts_m: FloatArray
    key_side_pts_m: FloatArray
    lock1_pts_m: FloatArray
    lock2_pts_m: FloatArray
    lock_side_pts_m: FloatArray
    surface_diff_m: FloatArray
    tactile_movement_too_large: bool
    relative_motion_mm: FloatArray
    error_too_large: bool
    is_success: bool


class LockOpeningEnv(TactileTaskEnv[LockScene, LockOpeningSettings]):
    """Pull a key outwards until its teeth stand below the slots of its lock, then lift it, by touch alone.

    The key starts up to 6.5 mm too deep in its lock, and the sensors grip its handle up to 2 mm off along the key and
    in height; the policy knows neither. World frame: z up, the lock's entrance towards +x. Actions outside -1 to 1
    are clipped (the 2025 code does not clip).

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("key1" to "key4"), `offset_mm` (x, y, z of the key from its deepest start),
    `sensor_jitter_mm` (x, z), and `rng_seed`, the integers that seed the episode's generator in place of the
    environment's own. What is left open is drawn: the key, x from 0 to 5 mm, and the jitter of up to 2 mm either way.

    Ends: terminated by success (`end_reason` "success"), even where a failure flag is raised with it; truncated by a
    sensing surface that moved more than 1.5 mm ("tactile"), a tooth far out of place ("error"), 50 env steps ("steps"),
    or physics that did not converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `LockOpeningSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = LockOpeningSettings
    scene_type: ClassVar = LockScene
    shape_type: ClassVar = KeyShape
    training_ranges: ClassVar = TRAINING_RANGES
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET, JITTER)

    def _solids(self) -> list[SurfaceMesh]:
        meshes, gap_mm = self._meshes, self.settings.slot_clearance_mm
        return [solid for shape in KeyShape for solid in (key_mesh(meshes, shape), lock_mesh(meshes, shape, gap_mm))]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: LockOpeningSettings
    ) -> LockStart:
        """Return the start that the options give, or draw it: key, x, then size and sign of each jitter."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            offset = KeyOffset(x_mm=settings.random_x_mm * random.random(), y_mm=0.0, z_mm=0.0)
        else:
            offset = self._read_offset(wanted)
        jitter = options.get(JITTER)
        if jitter is None:
            jitter = [_random_sided(random, largest_mm) for largest_mm in self._largest_jitter_mm(settings)]
        expected = f"expected (x, z) in mm within {LARGEST_JITTER_MM:g} either way"
        ranges = either_way(LARGEST_JITTER_MM, LARGEST_JITTER_MM)
        x_mm, z_mm = numbers(self.env_id, JITTER, jitter, ranges, expected)
        return LockStart(shape=shape, offset=offset, jitter=SensorJitter(x_mm=x_mm, z_mm=z_mm))

    def _read_offset(self, value: Any) -> KeyOffset:
        """Return the offset that the option gives, if the key is clear of its lock there."""
        low, high = X_RANGE_MM
        expected = (
            f"expected (x, y, z) in mm with {low:g} <= x <= {high:g}, |y| <= {LARGEST_Y_MM:g}, |z| <= {LARGEST_Z_MM:g}"
        )
        ranges = (X_RANGE_MM, *either_way(LARGEST_Y_MM, LARGEST_Z_MM))
        x_mm, y_mm, z_mm = numbers(self.env_id, OFFSET, value, ranges, expected)
        return KeyOffset(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)

    def _largest_jitter_mm(self, settings: LockOpeningSettings) -> tuple[float, float]:
        """Return the largest drawn jitter along the key, and in height."""
        return settings.jitter_mm, settings.jitter_mm

    def _error(self) -> float:
        return alignment_error(self.task_scene.state())

    def _judge(self) -> Flags:
        return judge_flags(self.task_scene.state(), max_steps=self.settings.max_steps)

    def _reward(self, flags: Flags, progress: float) -> float:
        return reward(
            flags,
            self.scene.surface_diff_m(),
            progress=progress,
            step_penalty=self.settings.step_penalty,
            final_reward=self.settings.final_reward,
            failure_penalty=self.settings.failure_penalty,
        )

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        state = scene.state()
        info: LockInfo = {
            "steps": state.env_steps,
            "key1_pts_m": state.rear_tooth_m,
            "key2_pts_m": state.front_tooth_m,
            "key_side_pts_m": scene.tip_m(),
            "lock1_pts_m": state.rear_slot_m,
            "lock2_pts_m": state.front_slot_m,
            "lock_side_pts_m": state.entrance_m,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "relative_motion_mm": scene.relative_motion_mm(),
            "error_too_large": flags.error_too_large,
            "is_success": flags.is_success,
        }
        return {**info}


def _random_sided(random: np.random.Generator, largest: float) -> float:
    """Return a size from 0 to the largest, then a sign."""
    size = largest * random.random()
    return size if random.integers(2) else -size


# Above the least height at which the lock opens [mm].
_LIFT_MARGIN_MM = 0.5


def out_and_up(_: Observation, info: Info) -> ActionArray:
    """Go out until the rear tooth is below its slot, and up into it, at once: the teeth rub along the ceiling."""
    tooth_m, slot_m = info["key1_pts_m"], info["lock1_pts_m"]
    inwards_mm = 1e3 * (tooth_m[:, 0].mean() - slot_m[:, 0].mean())
    down_mm = 1e3 * (tooth_m[:, 2].min() - SUCCESS_Z_RANGE_M[0]) - _LIFT_MARGIN_MM
    return longest_action(np.array([inwards_mm, down_mm]), np.array(TASK.action_scale))
