"""A scene: gels and affine bodies that are stepped together, one IPC step at a time."""

from collections.abc import Callable, Mapping, Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...signals import signals_wait
from ..contact.forces import ContactMemory, PairForces, empty_memory, no_forces, pair_forces, sorted_memory
from ..contact.overlap import find_overlap
from ..contact.weakening import weaken_friction
from ..elastic.elasticity import measure_stretches
from ..elastic.viscosity import build_branches, follow_strain, held_stress_pa
from ..model.mesh import GelBody, PointLoad, RigidBody
from ..model.model import Model, Surfaces, point_positions
from ..model.settings import (
    AnyContactSettings,
    ArenaContactSettings,
    ContactSettings,
    FrictionWeakening,
    SolverSettings,
)
from ..solver.assembly import Workspace, new_workspace
from ..solver.iterate import find_contacts, remember_step
from ..solver.newton import Counter, StepMeasure
from .attempt import Effort, StepAttempt
from .builder import build_model
from .coupling import NO_COUPLINGS, PLANNED_WITHIN_M, boxes_come_near, includes, near_nodes
from .layout import NodeLayout, SceneError, check_bodies, check_settings
from .report import StepReport, StepStatus

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# In how many shorter IPC steps one is played that has no solution.
_SHORTER_STEPS = (4, 16, 64)
# Parts of friction that are left, one after the other, in an IPC step that has no solution in any other way.
_FRICTION_LEFT = (0.5, 0.25, 0.125, 0.0)


class SceneState(NamedTuple):
    """State of a scene: nodes, shapes [n, 3], what contacts remember, and strains of viscous branches, [b, c, 6].

    With it goes for which nodes of different gels [k, 2] the matrix has places: rounding depends on them.
    """

    positions_m: FloatArray
    velocities_m_s: FloatArray
    memory: ContactMemory
    viscous_strain: FloatArray
    couplings: IndexArray = NO_COUPLINGS


class Scene:
    """Steps gels and affine bodies through driven motions, each step solved to convergence.

    `gravity_m_s2` acts on bodies that can move freely, in the world [m/s^2], shape [3]; gels that are driven weigh
    nothing.

    Raises:
        SceneError: a body is misplaced, bodies overlap at the start, or a material or setting is out of range.
    """

    def __init__(
        self,
        *,
        gels: Sequence[GelBody],
        bodies: Sequence[RigidBody],
        time_step_s: float,
        contact: AnyContactSettings | None = None,
        solver: SolverSettings | None = None,
        gravity_m_s2: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._gels = tuple(gels)
        self._bodies = tuple(bodies)
        self._contact = contact or ContactSettings()
        self._solver = solver or SolverSettings()
        check_bodies(self._gels, self._bodies)
        check_settings(time_step_s, self._contact, self._solver)
        self._layout = NodeLayout(self._gels, self._bodies)
        placed = zip(self._gels, self._layout.gel_slices, strict=True)
        self._driven = [gel.mesh.driven_nodes + rows.start for gel, rows in placed]
        self._time_step_s = time_step_s
        self._couplings = NO_COUPLINGS
        self._model = self._build_model()
        self._surfaces = self._model.surfaces
        self._placed_m = self._layout.initial_positions_m()
        self._weight_n = self._weigh(gravity_m_s2)
        self._x = self._placed_m.copy()
        self._branches = build_branches(self._gels, time_step_s)
        self._viscous_strain = np.zeros((*self._branches.rate.shape, 6))
        self._workspace = self._new_workspace()
        self._velocity = np.zeros_like(self._x)
        self._memory = empty_memory()
        self._last_start: tuple[FloatArray, ContactMemory] | None = None
        self._refuse_overlap()

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle needs: all but the scratch, whose arrays share memory."""
        return {name: value for name, value in vars(self).items() if name != "_workspace"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over a state, with scratch of its own."""
        vars(self).update(state)
        self._workspace = self._new_workspace()

    def _build_model(self) -> Model:
        return build_model(self._layout, self._time_step_s, self._contact, self._solver, self._couplings)

    def _couple(self, couplings: IndexArray) -> None:
        """Give the matrix places for nodes of different gels, shape [k, 2]."""
        self._couplings = couplings
        self._model = self._build_model()
        self._workspace = self._new_workspace()

    def _couple_touching_gels(self) -> None:
        """Make the places for gels that have come near each other, or slid to other nodes."""
        reach_m = self._contact.d_hat_m + self._solver.candidate_margin_m
        if not boxes_come_near([self._x[rows] for rows in self._layout.gel_slices], reach_m):
            return
        if not includes(self._couplings, near_nodes(self._model, len(self._gels), self._x, reach_m)):
            self._couple(near_nodes(self._model, len(self._gels), self._x, PLANNED_WITHIN_M))

    def _new_workspace(self) -> Workspace:
        branches, hexahedra = self._branches.rate.shape
        return new_workspace(self._model.system, len(self._x), hexahedra if branches else 0)

    @signals_wait()
    def step(
        self,
        *,
        driven_targets_m: Sequence[FloatArray],
        displacements_m: Mapping[int, FloatArray] | None = None,
        loads: Mapping[int, PointLoad] | None = None,
    ) -> StepReport:
        """Advance one time step while the driven nodes of each gel move to their targets [m], shapes [d, 3].

        The state after NOT_CONVERGED is free of intersections and inversions but is no minimum.

        Args:
            driven_targets_m: of each gel.
            displacements_m: where fixed bodies are at the end, by number, from where they were placed [m], shapes [3];
                others stay.
            loads: from outside on movable bodies in this step, by number; their weight is not among them.
        """
        target, load_n = self._target(driven_targets_m, displacements_m or {}), self._load_n(loads or {})
        before, effort = self.state(), Effort()
        attempt = self._advance(target, load_n, effort, StepAttempt.solve)
        if attempt.status is StepStatus.NOT_CONVERGED and self._model.parameters.remembers_slip:
            attempt = self._advance_in_shorter_steps(before, target, load_n, effort)
        if attempt.status is StepStatus.NOT_CONVERGED:
            self.restore(before)
            attempt = self._advance(target, load_n, effort, StepAttempt.follow_balances)
        if attempt.status is StepStatus.NOT_CONVERGED and self._model.parameters.remembers_slip:
            attempt = self._give_way(before, target, load_n, effort)
        force, torque = self._net_load(self._workspace.system.gradient)
        counts, measures = effort.record
        largest_stretch, high_stretch = measure_stretches(self._model.elastic, self._model.hexahedra, self._x)
        return StepReport(
            status=attempt.status,
            newton_iterations=int(counts[Counter.ITERATIONS]),
            parts=attempt.parts,
            reusing_iterations=int(counts[Counter.REUSING_ITERATIONS]),
            projected_iterations=int(counts[Counter.PROJECTED_ITERATIONS]),
            unstable_solutions=int(counts[Counter.UNSTABLE]),
            saddle_escapes=effort.saddle_escapes,
            residual_n=float(measures[StepMeasure.RESIDUAL_N]),
            net_force_n=force,
            net_torque_n_m=torque,
            smallest_gap_m=float(measures[StepMeasure.SMALLEST_GAP_M]),
            smallest_det_f=float(measures[StepMeasure.SMALLEST_DET_F]),
            active_contacts=int(counts[Counter.ACTIVE_CONTACTS]),
            gel_forces_n=self._gel_forces_n(self._workspace.system.gradient),
            largest_stretch=largest_stretch,
            high_stretch=high_stretch,
            time_step_s=self._time_step_s,
        )

    def contact_forces(self) -> PairForces:
        """Return the forces of all contacts at the end of the last IPC step, bodies numbered from the first gel on."""
        if self._last_start is None:
            return no_forces()
        start, memory = self._last_start
        return pair_forces(self._model, self._x, start, memory)

    def gel_contact_forces_n(self) -> list[FloatArray]:
        """Return the forces of contacts on the nodes of each gel at the end of the last IPC step [N], shapes [n, 3]."""
        pairs, points = self.contact_forces(), self._model.points
        on_points, on_nodes = np.zeros((len(points.node_count), 3)), np.zeros_like(self._x)
        np.add.at(on_points, pairs.points, pairs.shares[:, :, None] * pairs.forces_n[:, None, :])
        of_gels = points.node_count == 1
        on_nodes[points.nodes[of_gels, 0]] = on_points[of_gels]
        return [on_nodes[rows] for rows in self._layout.gel_slices]

    def gel_positions_m(self, index: int) -> FloatArray:
        """Return the world positions of a gel's nodes [m], shape [n, 3] (a copy)."""
        return self._x[self._layout.gel_slices[index]].copy()

    def body_vertices_m(self, index: int) -> FloatArray:
        """Return the world positions of a rigid body's vertices [m], shape [v, 3] (a copy)."""
        frame = self._x[self._layout.body_slices[index]]
        weights = self._layout.body_weights[index]
        return np.asarray((weights[:, :, None] * frame[None, :, :]).sum(axis=1))

    def state(self) -> SceneState:
        """Return all that what follows depends on."""
        return SceneState(self._x.copy(), self._velocity.copy(), self._memory, self._viscous_strain, self._couplings)

    def restore(self, state: SceneState) -> None:
        """Go back to a state of this scene."""
        self._x[:] = state.positions_m
        self._velocity = state.velocities_m_s.copy()
        self._memory, self._last_start = state.memory, None
        self._viscous_strain = state.viscous_strain
        if not np.array_equal(state.couplings, self._couplings):
            self._couple(state.couplings)

    def state_bytes(self) -> bytes:
        """Return the state as little-endian float64 and int64, for hashing; empty parts add nothing."""
        numbers = (self._x, self._velocity, self._memory.slip_m, self._memory.direction, self._viscous_strain)
        return b"".join(array.astype("<f8").tobytes() for array in numbers) + self._memory.pairs.astype("<i8").tobytes()

    def _refuse_overlap(self) -> None:
        surfaces, points = (
            self._model.surfaces,
            np.empty((len(self._model.points.node_count), 3)),
        )
        point_positions(self._model.points, self._x, points)
        overlap = find_overlap(surfaces, points)
        if overlap.first_body < 0:
            return
        members: list[GelBody | RigidBody] = [*self._gels, *self._bodies]
        names = [f"{members[body].mesh.name} (body {body})" for body in (overlap.first_body, overlap.second_body)]
        where = "one lies inside the other"
        if overlap.edge >= 0:
            ends = points[surfaces.edges[overlap.edge]].round(6).tolist()
            corners = points[surfaces.triangles[overlap.triangle]].round(6).tolist()
            where = f"the edge from {ends[0]} to {ends[1]} m crosses the triangle {corners} m"
        raise SceneError(f"{names[0]} and {names[1]} overlap at the start: {where}; place them apart.")

    def _take_friction(self, part: float) -> None:
        """Let surfaces rub as they do in this IPC step, or with a part of that."""
        surfaces = self._surfaces
        if isinstance(self._contact, ArenaContactSettings) and self._contact.weakening is not None:
            surfaces = self._weaken(self._contact.weakening)
        if part != 1.0:
            surfaces = surfaces._replace(pair_friction=part * surfaces.pair_friction)
        if surfaces is not self._model.surfaces:
            self._model = self._model._replace(surfaces=surfaces)

    def _weaken(self, law: FrictionWeakening) -> Surfaces:
        y, velocity = np.empty((2, len(self._model.points.node_count), 3))
        point_positions(self._model.points, self._x, y)
        point_positions(self._model.points, self._velocity, velocity)
        friction = weaken_friction(law, self._surfaces, self._memory, y, velocity)
        return self._surfaces._replace(pair_friction=friction)

    def _target(self, driven_targets_m: Sequence[FloatArray], displacements_m: Mapping[int, FloatArray]) -> FloatArray:
        if len(driven_targets_m) != len(self._gels):
            raise SceneError(f"Got driven targets for {len(driven_targets_m)} gels, expected {len(self._gels)}.")
        target = self._x.copy()
        for index, (driven, wanted) in enumerate(zip(self._driven, driven_targets_m, strict=True)):
            expected = (len(driven), 3)
            if wanted.shape != expected:
                raise SceneError(f"Driven targets of gel {index} have shape {wanted.shape}, expected {expected} [m].")
            if not np.isfinite(wanted).all():
                wrong = int(np.flatnonzero(~np.isfinite(wanted).all(axis=1))[0])
                node, given = self._gels[index].mesh.driven_nodes[wrong], wanted[wrong]
                raise SceneError(f"The target of node {node} of gel {index} is {given}, expected finite numbers [m].")
            target[driven] = wanted
        for index, displacement_m in displacements_m.items():
            if not self._bodies[index].fixed:
                raise SceneError(f"Body {index} can move freely; only fixed bodies can be displaced.")
            if displacement_m.shape != (3,) or not np.isfinite(displacement_m).all():
                raise SceneError(
                    f"The displacement of body {index} is {displacement_m}, expected three finite numbers [m]."
                )
            rows = self._layout.body_slices[index]
            target[rows] = self._placed_m[rows] + displacement_m
        return target

    def _weigh(self, gravity_m_s2: Sequence[float]) -> FloatArray:
        """Return the weights of what can move freely at its nodes and frame points [N], shape [n, 3]."""
        weight_n, gravity = np.zeros_like(self._placed_m), np.array(gravity_m_s2, dtype=np.float64)
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise SceneError(f"gravity_m_s2 is {gravity_m_s2}, expected three finite numbers.")
        affine = self._model.affine
        for first, mass_kg in zip(affine.first_node, affine.mass_kg, strict=True):
            weight_n[first : first + 4] = mass_kg.sum(axis=1)[:, None] * gravity
        for gel, rows in zip(self._gels, self._layout.gel_slices, strict=True):
            if gel.mesh.is_free:
                weight_n[rows] = self._model.unknowns.node_mass_kg[rows, None] * gravity
        return weight_n

    def _load_n(self, loads: Mapping[int, PointLoad]) -> FloatArray:
        """Return the forces from outside at all nodes [N], shape [n, 3]: weights and the loads of a step."""
        load_n = self._weight_n.copy()
        for index, (force_n, point_m) in loads.items():
            if self._bodies[index].fixed:
                raise SceneError(f"Body {index} is fixed; only movable bodies can be loaded.")
            if np.shape(force_n) != (3,) or not np.isfinite([force_n, point_m]).all():
                raise SceneError(f"The load of body {index} is {force_n} N at {point_m} m, expected finite numbers.")
            weights = self._layout.point_weights(index, point_m)
            load_n[self._layout.body_slices[index]] += weights[:, None] * force_n
        return load_n

    def _advance(
        self,
        target: FloatArray,
        load_n: FloatArray,
        effort: Effort,
        solve: Callable[[StepAttempt], tuple[StepStatus, int]],
        friction: float = 1.0,
    ) -> StepAttempt:
        """Move the prescribed nodes to their targets in an IPC step that is solved as given; return how that ended.

        `friction` is the part of it that is left.
        """
        self._couple_touching_gels()
        start, time_step_s = self._x.copy(), self._time_step_s
        self._take_friction(friction)
        attempt = StepAttempt(
            model=self._model,
            solver=self._solver,
            workspace=self._workspace,
            x=self._x,
            start=start,
            memory=self._memory,
            x_hat=start + time_step_s * self._velocity,
            target=target,
            load_n=load_n,
            held=np.zeros_like(start),
            effort=effort,
        )
        self._last_start = start, self._memory
        if len(self._viscous_strain):
            self._workspace.hexahedron.held_pa[:] = held_stress_pa(self._branches, self._viscous_strain)
        attempt.status, attempt.parts = solve(attempt)
        self._velocity = (self._x - start) / time_step_s
        if self._model.parameters.remembers_slip:
            near = None if attempt.status == StepStatus.NOT_CONVERGED else attempt.near
            near = near or find_contacts(self._model, self._x)
            self._memory = sorted_memory(remember_step(self._model, near, self._x, start, attempt.memory))
        if len(self._viscous_strain):
            strain = follow_strain(self._branches, self._viscous_strain, self._model.hexahedra, self._x)
            self._viscous_strain = strain
        return attempt

    def _advance_in_shorter_steps(
        self, before: SceneState, target: FloatArray, load_n: FloatArray, effort: Effort
    ) -> StepAttempt:
        """Play an IPC step as several shorter ones, which remember what slips in each, until all are solved.

        A balance with strong friction may not exist where a long step is said to lead, and exist along the way.
        """
        whole_s, start = self._time_step_s, before.positions_m
        for count in _SHORTER_STEPS:
            self.restore(before)
            self._set_time_step(whole_s / count)
            for part in range(1, count + 1):
                attempt = self._advance(start + (part / count) * (target - start), load_n, effort, StepAttempt.solve)
                if attempt.status is StepStatus.NOT_CONVERGED:
                    break
            else:
                attempt.status, attempt.parts = StepStatus.SHORTENED, count
                break
        self._set_time_step(whole_s)
        return attempt

    def _give_way(self, before: SceneState, target: FloatArray, load_n: FloatArray, effort: Effort) -> StepAttempt:
        """Play an IPC step with less and less friction until it is solved; without any there is a least energy."""
        for part in _FRICTION_LEFT:
            self.restore(before)
            attempt = self._advance(target, load_n, effort, StepAttempt.solve, friction=part)
            if attempt.status is not StepStatus.NOT_CONVERGED:
                attempt.status = StepStatus.GAVE_WAY
                break
        return attempt

    def _set_time_step(self, time_step_s: float) -> None:
        self._time_step_s = time_step_s
        self._branches = build_branches(self._gels, time_step_s)
        self._model = self._build_model()._replace(surfaces=self._model.surfaces)

    def _gel_forces_n(self, gradient: FloatArray) -> tuple[tuple[float, float, float], ...]:
        held = (gradient[driven].sum(axis=0).tolist() for driven in self._driven)
        return tuple((-x, -y, -z) for x, y, z in held)

    def _net_load(self, gradient: FloatArray) -> tuple[float, float]:
        """Return the largest net force [N] and torque [N m] left on a movable body, summed over its frame points."""
        force, torque = 0.0, 0.0
        for body, rows in zip(self._bodies, self._layout.body_slices, strict=True):
            if not body.fixed:
                loads, places = gradient[rows].tolist(), self._x[rows].tolist()
                (fx, fy, fz), (tx, ty, tz) = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
                for (px, py, pz), (lx, ly, lz) in zip(places, loads, strict=True):
                    ax, ay, az = px - places[0][0], py - places[0][1], pz - places[0][2]
                    fx, fy, fz = fx + lx, fy + ly, fz + lz
                    tx, ty, tz = tx + (ay * lz - az * ly), ty + (az * lx - ax * lz), tz + (ax * ly - ay * lx)
                force, torque = (
                    max(force, sqrt(fx * fx + fy * fy + fz * fz)),
                    max(torque, sqrt(tx * tx + ty * ty + tz * tz)),
                )
        return force, torque
