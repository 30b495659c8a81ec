"""A part held between two gels: the physics, the gripper that moves them, and what both sensors see of it."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..deterministic_math import sine_cosine
from ..fem.contact.forces import PairForces
from ..fem.model.mesh import GelBody, PronyBranch, RigidBody, SurfaceMesh
from ..fem.model.settings import AnyContactSettings, ContactSettings, SolverSettings, repr_without_defaults
from ..fem.scene.layout import placed
from ..fem.scene.report import StepReport, StepStatus
from ..fem.scene.scene import Scene, SceneState
from ..tactile.camera import CameraIntrinsics
from ..tactile.gel import highest_mm
from ..tactile.markers import MarkerSettings
from ..tactile.sensor import TactileSensor
from .gripper import SENSOR_COUNT, Gripper, GripperPose, SensorPose


class Stopwatch:
    """Context manager that adds the CPU time of the calling thread [s] to `elapsed_s`."""

    def __init__(self) -> None:
        self.elapsed_s = 0.0
        self._started_s = 0.0

    def __enter__(self) -> None:
        self._started_s = thread_time()

    def __exit__(self, *exception: object) -> None:
        self.elapsed_s += thread_time() - self._started_s


FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PhysicsSettings:
    """Materials and stepping of a scene; the defaults are the 2025 evaluation's.

    Attributes:
        time_step_s: length of an IPC step [s].
        contact: contact model with its constants.
        solver: when an IPC step counts as solved.
        youngs_modulus_pa: of both gels [Pa].
        poisson_ratio: of both gels.
        gel_density_kg_m3: [kg/m3].
        gel_friction: friction coefficient of the gels; a pair of bodies has the mean of its two.
        rigid_density_kg_m3: of all rigid parts [kg/m3].
        viscosity: branches of both gels, which then are of hexahedra; modulus and ratio above are those at rest.
        yeoh: C20 and C30 of both gels over their C10, which then are of hexahedra.
        gravity_m_s2: by which rigid parts that can move are heavy, downwards [m/s^2].
    """

    time_step_s: float = 0.1
    contact: AnyContactSettings = field(default_factory=ContactSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    youngs_modulus_pa: float = 3e5
    poisson_ratio: float = 0.3
    gel_density_kg_m3: float = 1000.0
    gel_friction: float = 87.5
    rigid_density_kg_m3: float = 500.0
    viscosity: tuple[PronyBranch, ...] = ()
    yeoh: tuple[float, float] = (0.0, 0.0)
    gravity_m_s2: float = 0.0

    def __repr__(self) -> str:
        """Return all fields, the last three only where they are set: mesh hashes of settings without them stay."""
        return repr_without_defaults(self, "viscosity", "yeoh", "gravity_m_s2")


@dataclass(frozen=True, kw_only=True)
class Clocks:
    """CPU time by kind of work, summed over all episodes of an environment."""

    physics: Stopwatch
    markers: Stopwatch


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspState:
    """State of a grasped scene, see `GraspedScene.state`.

    Attributes:
        physics: positions and velocities of all nodes, and what contacts remember.
        references_m: undisturbed views of the sensors [m], shape [s, 3] each.
        pose: of the gripper.
        ipc_steps: solved so far.
        solved: every IPC step so far converged.
        reports: those that nobody has taken yet.
        last_report: of the last IPC step; None before the first.
        last_flow: marker flow that was drawn last, after how many IPC steps.
        seen_m: views of the running env step, see `GraspedScene.begin_env_step`.
    """

    physics: SceneState
    references_m: tuple[FloatArray, ...]
    pose: GripperPose
    ipc_steps: int
    solved: bool
    reports: tuple[StepReport, ...]
    last_report: StepReport | None
    last_flow: tuple[int, NDArray[np.float32]]
    seen_m: tuple[list[FloatArray], ...]


@dataclass(kw_only=True)
class _Measurements:
    """What was measured since the last IPC step, once, however often it is asked for; None as long as nobody has.

    Attributes:
        views_m: what both sensors see [m], shape [s, 3] each.
        held_m: all vertices of the held part's surface in the world [m], shape [v, 3].
        surface_diff_m: mean motion of both sensing surfaces since the reference [m].
        gel_contact_forces_n: forces of contacts on the nodes of both gels [N], shape [2, n, 3].
    """

    views_m: list[FloatArray] | None = None
    held_m: FloatArray | None = None
    surface_diff_m: list[float] | None = None
    gel_contact_forces_n: FloatArray | None = None


def fixed_at_origin(mesh: SurfaceMesh, *, friction: float) -> RigidBody:
    """Return a part that never moves, its own frame being the world's."""
    return RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.zeros(3), friction=friction, fixed=True)


def _surface(part: RigidBody | GelBody) -> SurfaceMesh:
    if isinstance(part, RigidBody):
        return part.mesh
    vertices_m, triangles = part.mesh.surface
    return SurfaceMesh(vertices_m=vertices_m, triangles=triangles, name=part.mesh.name)


def _driven_m(part: GelBody, time_s: float) -> FloatArray:
    """Return where the driven nodes of a soft part are at a time [m], shape [d, 3]."""
    placed_m = placed(part.mesh.rest_position_m[part.mesh.driven_nodes], part)
    return placed_m if part.motion is None else placed_m + part.motion(time_s)


class GraspedScene:
    """Two gels on a gripper, the part they hold, the rigid part it goes into, which is fixed, and any others.

    After an IPC step that did not converge nothing moves: `solved` is False and stays so. Without gravity and load a
    part that can move and that nothing touches keeps its speed, which is zero at the start.

    Attributes:
        gel: mesh of both gels.
        held: the held part, where it was placed: a rigid one, or a soft one without driven nodes.
        held_surface: its surface at rest, in its own frame.
        fixed: the fixed part.
        others: further parts: rigid ones, fixed or movable, and soft ones, whose driven nodes go with their motion.
            Pictures show the fixed ones.
        physics: materials and stepping.
        ipc_steps: solved so far.
        solved: every IPC step so far converged.
        after_ipc_step: called after every IPC step, for pictures; it must not move anything.
    """

    def __init__(
        self,
        *,
        gripper: Gripper,
        held: RigidBody | GelBody,
        fixed: RigidBody,
        physics: PhysicsSettings,
        sensors: tuple[TactileSensor, TactileSensor],
        clocks: Clocks,
        others: Sequence[RigidBody | GelBody] = (),
    ) -> None:
        self.gel, self.held, self.fixed, self.physics = gripper.gel, held, fixed, physics
        self.others, self.held_surface = tuple(others), _surface(held)
        self.after_ipc_step: Callable[[], None] | None = None
        self._clocks = clocks
        self._gripper = gripper
        self._sensors = sensors
        parts = (held, fixed, *others)
        bodies = [part for part in parts if isinstance(part, RigidBody)]
        self._soft = [part for part in parts if isinstance(part, GelBody)]
        # The physics numbers gels first; at each of its numbers that of `pair_forces`.
        is_rigid = [False] * SENSOR_COUNT + [isinstance(part, RigidBody) for part in parts]
        self._numbers = np.argsort(is_rigid, kind="stable")
        self._motions = {number: body.motion for number, body in enumerate(bodies) if body.motion is not None}
        self._loads = {number: body.load for number, body in enumerate(bodies) if body.load is not None}
        with clocks.physics:
            self._scene = Scene(
                gels=[*(self._placed_gel(index) for index in range(SENSOR_COUNT)), *self._soft],
                bodies=bodies,
                time_step_s=physics.time_step_s,
                contact=physics.contact,
                solver=physics.solver,
                gravity_m_s2=(0.0, 0.0, -physics.gravity_m_s2),
            )
        self._reports: list[StepReport] = []
        self._last_report: StepReport | None = None
        self.ipc_steps = 0
        self.solved = True
        self._last_flow = (-1, np.zeros((0,), np.float32))
        self._measured = _Measurements()
        self._seen_m: list[list[FloatArray]] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle needs; what draws after every IPC step looks at this scene only."""
        return {**vars(self), "after_ipc_step": None}

    @property
    def camera(self) -> CameraIntrinsics:
        """Intrinsics of both sensors' cameras."""
        return self._sensors[0].camera

    @property
    def pose(self) -> GripperPose:
        """Present pose of the gripper."""
        return self._gripper.pose

    @property
    def gripper_width_m(self) -> float:
        """Commanded width between both gels' highest points where nothing presses on them [m]."""
        return 2.0 * (self._gripper.pose.half_opening_m - 1e-3 * highest_mm(self.gel))

    @property
    def time_s(self) -> float:
        """Simulated time since the scene was built [s]."""
        return self.ipc_steps * self.physics.time_step_s

    def move_to(self, goal: GripperPose, *, ipc_steps: int) -> None:
        """Drive the gels to a pose in equal IPC steps; stops at the first that does not converge."""
        start = self._gripper.pose
        for part in range(1, ipc_steps + 1):
            if not self.solved:
                return
            self._step_towards(start.towards(goal, part, ipc_steps))

    def begin_env_step(self) -> None:
        """Note what both sensors see, and after every IPC step from here on: a delayed observation is between two."""
        if self._markers.delay > 0.0:
            self._seen_m = [self._views_m()]

    def capture_references(self) -> None:
        """Take what both sensors see now as their undisturbed view."""
        for sensor, view_m in zip(self._sensors, self._views_m(), strict=True):
            sensor.capture_reference(view_m)
        self._measured.surface_diff_m = None

    def surface_points_m(self) -> FloatArray:
        """Return the sensing nodes in the camera frames [m], shape [2, 2, s, 3]: sensor, reference or current, node."""
        pairs = zip(self._sensors, self._views_m(), strict=True)
        return np.array([(sensor.reference_m, view_m) for sensor, view_m in pairs])

    def surface_diff_m(self) -> FloatArray:
        """Return the mean motion of the left and right sensing surface since the reference [m], shape [2]."""
        if self._measured.surface_diff_m is None:
            pairs = zip(self._sensors, self._views_m(), strict=True)
            self._measured.surface_diff_m = [sensor.surface_diff_m(view_m) for sensor, view_m in pairs]
        return np.array(self._measured.surface_diff_m)

    def marker_flow(self, random: np.random.Generator) -> NDArray[np.float32]:
        """Return the marker flow of the left, then the right sensor [pixel], shape [2, 2, 128, 2]."""
        with self._clocks.markers:
            pairs = zip(self._sensors, self._delayed_views_m(), strict=True)
            drawn = np.stack([sensor.marker_flow(view_m, random) for sensor, view_m in pairs])
            flow = self._drifted(drawn).astype(np.float32)
        self._last_flow = (self.ipc_steps, flow)
        return flow

    def last_marker_flow(self, random: np.random.Generator) -> NDArray[np.float32]:
        """Return the marker flow that was drawn last, or a new one if something has moved since."""
        at, flow = self._last_flow
        return flow if at == self.ipc_steps else self.marker_flow(random)

    def lost_markers_px(self) -> list[FloatArray]:
        """Return where markers are that the last marker flow lost, of the left and the right sensor, shapes [l, 2]."""
        return [self._drifted(sensor.lost_px[None].copy())[0, 1] for sensor in self._sensors]

    def held_vertices_m(self, vertices: NDArray[np.int64]) -> FloatArray:
        """Return the world positions of chosen vertices of the held part's surface [m], shape [n, 3]."""
        if self._measured.held_m is None:
            held_m = self._part_vertices_m(SENSOR_COUNT)
            self._measured.held_m = held_m[self.held.mesh.surface_nodes] if isinstance(self.held, GelBody) else held_m
        return self._measured.held_m[vertices]

    def other_vertices_m(self, index: int) -> FloatArray:
        """Return the world positions of all vertices or nodes of one of the other parts [m], shape [v, 3]."""
        return self._part_vertices_m(SENSOR_COUNT + 2 + index)

    def _part_vertices_m(self, number: int) -> FloatArray:
        """Return the vertices or nodes of a part, numbered as in `pair_forces` [m], shape [v, 3]."""
        of_physics, gels = int(np.flatnonzero(self._numbers == number)[0]), SENSOR_COUNT + len(self._soft)
        if of_physics < gels:
            return self._scene.gel_positions_m(of_physics)
        return self._scene.body_vertices_m(of_physics - gels)

    def fixed_shift_m(self) -> FloatArray:
        """Return where the fixed part is now, from where it was placed [m], shape [3]."""
        return np.zeros(3) if self.fixed.motion is None else self.fixed.motion(self.time_s)

    def fixed_surface(self) -> SurfaceMesh:
        """Return the surfaces of all fixed parts where they were placed, as one in the world."""
        parts = [self.fixed, *(part for part in self.others if isinstance(part, RigidBody) and part.fixed)]
        first = np.cumsum([0, *(len(part.mesh.vertices_m) for part in parts)])
        return SurfaceMesh(
            vertices_m=np.concatenate([placed(part.mesh.vertices_m, part) for part in parts]),
            triangles=np.concatenate([part.mesh.triangles + at for part, at in zip(parts, first, strict=False)]),
            name=self.fixed.mesh.name,
        )

    def gel_nodes_m(self, index: int) -> FloatArray:
        """Return the world positions of all nodes of the left (0) or right (1) gel [m], shape [n, 3]."""
        return self._scene.gel_positions_m(index)

    def sensor_pose(self, index: int) -> SensorPose:
        """Return the present pose of the left (0) or right (1) sensor."""
        return self._gripper.sensor_pose(index)

    def peak_part_force_n(self) -> float:
        """Return the largest force on the held part in the solved IPC steps since reports were taken last [N]."""
        solved = (report for report in self._reports if report.status is not StepStatus.NOT_CONVERGED)
        return max((report.part_force_n for report in solved), default=0.0)

    def grip_force_n(self) -> float:
        """Return the force with which both jaws squeeze the held part, the mean of both, in the last IPC step [N]."""
        return self._squeeze_n(self._last_report) if self._last_report else 0.0

    def peak_grip_force_n(self) -> float:
        """Return the largest grip force in the solved IPC steps since reports were taken last [N]."""
        solved = (report for report in self._reports if report.status is not StepStatus.NOT_CONVERGED)
        return max((self._squeeze_n(report) for report in solved), default=0.0)

    def _squeeze_n(self, report: StepReport) -> float:
        x, y, z = map(float, -self.sensor_pose(0).rotation[:, 2])
        (left_x, left_y, left_z), (right_x, right_y, right_z) = report.gel_forces_n
        return 0.5 * (x * (left_x - right_x) + y * (left_y - right_y) + z * (left_z - right_z))

    def contact_forces_n(self) -> FloatArray:
        """Return the force of what does not hold the part on it, and of the contacts on each gel [N], shape [3, 3].

        They are those of the last IPC step, in the world.
        """
        gels = np.array(self._last_report.gel_forces_n) if self._last_report else np.zeros((SENSOR_COUNT, 3))
        return np.concatenate([gels.sum(axis=0, keepdims=True), gels])

    def gel_contact_forces_n(self) -> FloatArray:
        """Return the forces of contacts on the nodes of the left and the right gel [N], in the world, shape [2, n, 3].

        They are those of the last IPC step; zero before the first one, also after `restore`.
        """
        if self._measured.gel_contact_forces_n is None:
            self._measured.gel_contact_forces_n = np.array(self._scene.gel_contact_forces_n()[:SENSOR_COUNT])
        return self._measured.gel_contact_forces_n

    def wrench_on_gripper(self, above_m: float) -> FloatArray:
        """Return force [N] and moment [N m] of all contacts on the gripper's gels, in its axes, shape [6].

        Args:
            above_m: height of the point that the moment is about above the middle between both gels' centres [m].
        """
        pose, forces_n = self._gripper.pose, self.gel_contact_forces_n().reshape(-1, 3)
        about_m = np.array([pose.x_m, pose.y_m, pose.z_m + above_m])
        arms_m = np.concatenate([self.gel_nodes_m(index) for index in range(SENSOR_COUNT)]) - about_m
        wrench = np.concatenate([forces_n, np.cross(arms_m, forces_n)], axis=1).sum(axis=0).reshape(2, 3)
        sine, cosine = sine_cosine(pose.angle_rad)
        x, y, z = wrench.T
        return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1).ravel()

    def pair_forces(self) -> PairForces:
        """Return the forces of contacts in the last IPC step.

        Bodies 0 and 1 are the gripper's gels, then come the held part, the fixed one, and the others in their order.
        """
        pairs = self._scene.contact_forces()
        return pairs._replace(bodies=self._numbers[pairs.bodies])

    def force_on_held_n(self, body: int) -> FloatArray:
        """Return the force of one body, numbered as in `pair_forces`, on the held part in the last IPC step [N]."""
        pairs, held = self.pair_forces(), SENSOR_COUNT
        sign = (pairs.bodies == (held, body)).all(axis=1) * 1.0 - (pairs.bodies == (body, held)).all(axis=1) * 1.0
        return np.asarray((sign[:, None] * pairs.forces_n).sum(axis=0))

    def take_reports(self) -> tuple[StepReport, ...]:
        """Return the report of the IPC steps since the last call."""
        reports, self._reports = tuple(self._reports), []
        return reports

    def state(self) -> GraspState:
        """Return all that what follows depends on, for `restore`."""
        return GraspState(
            physics=self._scene.state(),
            references_m=tuple(sensor.reference_m for sensor in self._sensors),
            pose=self._gripper.pose,
            ipc_steps=self.ipc_steps,
            solved=self.solved,
            reports=tuple(self._reports),
            last_report=self._last_report,
            last_flow=self._last_flow,
            seen_m=tuple(self._seen_m),
        )

    def restore(self, state: GraspState) -> None:
        """Go back to a state of this scene."""
        self._scene.restore(state.physics)
        for sensor, reference_m in zip(self._sensors, state.references_m, strict=True):
            sensor.capture_reference(reference_m)
        self._gripper.pose = state.pose
        self.ipc_steps, self.solved = state.ipc_steps, state.solved
        self._reports, self._last_report = list(state.reports), state.last_report
        self._last_flow = state.last_flow
        self._seen_m = list(state.seen_m)
        self._measured = _Measurements()

    def state_hash(self) -> str:
        """Return the SHA-256 [hex] of all positions and velocities."""
        return hashlib.sha256(self._scene.state_bytes()).hexdigest()

    def _placed_gel(self, index: int) -> GelBody:
        sensor, physics = self.sensor_pose(index), self.physics
        return GelBody(
            mesh=self.gel,
            rotation=sensor.rotation,
            translation_m=sensor.centre_m,
            youngs_modulus_pa=physics.youngs_modulus_pa,
            poisson_ratio=physics.poisson_ratio,
            density_kg_m3=physics.gel_density_kg_m3,
            friction=physics.gel_friction,
            viscosity=physics.viscosity,
            yeoh=physics.yeoh,
        )

    def _step_towards(self, pose: GripperPose) -> None:
        self._measured = _Measurements()
        time_s = (self.ipc_steps + 1) * self.physics.time_step_s
        with self._clocks.physics:
            report = self._scene.step(
                driven_targets_m=[
                    *self._gripper.driven_targets_m(pose),
                    *(_driven_m(part, time_s) for part in self._soft),
                ],
                displacements_m={number: motion(time_s) for number, motion in self._motions.items()},
                loads={number: load(time_s) for number, load in self._loads.items()},
            )
        if self._soft:  # Only the gripper's gels hold the part.
            report = replace(report, gel_forces_n=report.gel_forces_n[:SENSOR_COUNT])
        self.ipc_steps += 1
        self._reports.append(report)
        self._last_report = report
        self.solved = report.status is not StepStatus.NOT_CONVERGED
        self._gripper.pose = pose
        if self._seen_m:
            self._seen_m.append(self._views_m())
        if self.after_ipc_step is not None:
            self.after_ipc_step()

    @property
    def _markers(self) -> MarkerSettings:
        return self._sensors[0].settings

    def _delayed_views_m(self) -> list[FloatArray]:
        """Return what is observed of both sensing faces [m]: what was seen a part of the env step ago."""
        if not self._seen_m:
            return self._views_m()
        moment = (1.0 - self._markers.delay) * (len(self._seen_m) - 1)
        first = int(moment)
        part = moment - first
        pairs = zip(self._seen_m[first], self._seen_m[min(first + 1, len(self._seen_m) - 1)], strict=True)
        return [(1.0 - part) * earlier_m + part * later_m for earlier_m, later_m in pairs]

    def _drifted(self, flow: FloatArray) -> FloatArray:
        """Return a marker flow whose current positions have drifted since the start of the episode."""
        speed_px_s = (self._markers.drift_u_px_s, self._markers.drift_v_px_s)
        if any(speed_px_s):
            flow[:, 1] += np.array(speed_px_s) * self.time_s
        return flow

    def _views_m(self) -> list[FloatArray]:
        """Return what both sensors see [m]."""
        if self._measured.views_m is None:
            self._measured.views_m = [
                sensor.view_m(self.gel_nodes_m(index), pose.rotation, pose.centre_m)
                for index, sensor in enumerate(self._sensors)
                for pose in [self.sensor_pose(index)]
            ]
        return self._measured.views_m
