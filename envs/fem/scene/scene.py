"""A scene: gels and affine bodies that are stepped together, one IPC step at a time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...signals import signals_wait
from ..contact.broad_phase import Candidates
from ..contact.forces import ContactMemory, PairForces, empty_memory, no_forces, pair_forces, sorted_memory
from ..contact.overlap import find_overlap
from ..contact.weakening import weaken_friction
from ..elastic.elasticity import measure_stretches
from ..elastic.viscosity import build_branches, follow_strain, held_stress_pa
from ..model.mesh import GelBody, PointLoad, RigidBody
from ..model.model import PRESCRIBED, Model, Surfaces, point_positions
from ..model.settings import (
    AnyContactSettings,
    ArenaContactSettings,
    ContactSettings,
    CutOffSolverSettings,
    FrictionWeakening,
    SolverSettings,
)
from ..solver.assembly import Workspace, new_workspace
from ..solver.iterate import IpcStep, find_contacts, remember_step
from ..solver.newton import SOLVED, UNSOLVED, UNSTABLE, Counter, Record, StepMeasure, Tolerances, forces_at, solve_step
from ..solver.path import BalancePath
from .builder import build_model
from .coupling import NO_COUPLINGS, PLANNED_WITHIN_M, boxes_come_near, includes, near_nodes
from .layout import NodeLayout, SceneError, check_bodies, check_settings

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# The motion of an IPC step is the first guess of the next one where that of the driven nodes changes by less than this
# part of it, and no node went further than this multiple of it.
_LARGEST_CHANGE, _LONGEST_FOLLOWING = 0.5, 1.2
# Parts of the way from an IPC step's start to its end, where balances are followed along it.
_FIRST_STRIDE, _SHORTEST_STRIDE, _MOST_STRIDES = 1 / 8, 1 / 1024, 100
# Matrices on the path of balances, as a multiple of Newton's iterations.
_PATH_ITERATIONS = 35
# Of the forces held there: what rounding leaves of a balance of kilonewtons over a gap of nanometres.
_UNBALANCED_PART = 1e-8
# In how many shorter IPC steps one is played that has no solution.
_SHORTER_STEPS = (4, 16, 64)
# Parts of friction that are left, one after the other, in an IPC step that has no solution in any other way.
_FRICTION_LEFT = (0.5, 0.25, 0.125, 0.0)


class StepStatus(StrEnum):
    """How an IPC step ended."""

    CONVERGED = "converged"  # solved in one go
    DIVIDED = "divided"  # solved after the driven motion was divided
    ESCAPED_SADDLE = "escaped_saddle"  # solved after an unstable equilibrium was left along negative curvature
    RELAXED = "relaxed"  # solved after the forces were relaxed along their flow
    SHORTENED = "shortened"  # played as several shorter IPC steps, each solved
    CONTINUED = "continued"  # solved by following balances from the start, while held forces were let go
    GAVE_WAY = "gave_way"  # solved with part of the friction, as with all of it there was no solution
    CUT_OFF = "cut_off"  # ended after the iterations of `CutOffSolverSettings`, not solved
    NOT_CONVERGED = "not_converged"  # not solved; the state is free of intersections but is not a minimum


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What one IPC step took and left.

    Attributes:
        status: how it ended; a caller must not continue after NOT_CONVERGED.
        newton_iterations: Newton iterations, all parts together.
        parts: parts the driven motion was divided into where this state comes from, or shorter IPC steps.
        reusing_iterations: iterations that solved with the factors of an earlier one, among the Newton iterations.
        projected_iterations: iterations whose Hessian had to be projected to be positive definite.
        unstable_solutions: how often an equilibrium was reached whose Jacobian has a negative determinant.
        saddle_escapes: how often one was left in the end, as dividing led to no stable one.
        residual_n: largest force left on a node [N].
        net_force_n: largest net force left on a movable body [N].
        net_torque_n_m: largest net torque left on a movable body, about its centroid [N m].
        smallest_gap_m: smallest distance of two bodies [m]; infinite when nothing is within d_hat.
        smallest_det_f: smallest det F of all elements.
        active_contacts: pairs closer than d_hat.
        gel_forces_n: force of the contacts on each gel [N], as its driven nodes hold it; shape [g, 3].
        largest_stretch: largest principal stretch of the elements of all gels; 1 where nothing is stretched.
        high_stretch: the one that 95 % of these elements do not exceed.
        time_step_s: length of the step [s].
    """

    status: StepStatus
    newton_iterations: int
    parts: int
    reusing_iterations: int
    projected_iterations: int
    unstable_solutions: int
    saddle_escapes: int
    residual_n: float
    net_force_n: float
    net_torque_n_m: float
    smallest_gap_m: float
    smallest_det_f: float
    active_contacts: int
    gel_forces_n: tuple[tuple[float, float, float], ...] = ()
    largest_stretch: float = 1.0
    high_stretch: float = 1.0
    time_step_s: float = 0.1

    @property
    def part_force_n(self) -> float:
        """Force of what does not hold the part, as all gels together hold it [N]."""
        total = map(sum, zip(*self.gel_forces_n, strict=True))
        return sqrt(sum(along * along for along in total))


@dataclass(kw_only=True, eq=False)
class _Effort:
    """What an IPC step took, all attempts together."""

    record: Record = field(
        default_factory=lambda: Record(np.zeros(len(Counter), dtype=np.int64), np.zeros(len(StepMeasure)))
    )
    saddle_escapes: int = 0


@dataclass(kw_only=True, eq=False)
class _Attempt:
    """What an IPC step starts from and goes to, node positions [m] of shape [n, 3], and how it ended.

    Attributes:
        load_n: forces from outside [N], shape [n, 3].
        held: forces [N] of shape [n, 3] that are taken away from the step's own; zero but on the way to its end.
        effort: of the whole IPC step.
        near: candidates where the last motion ended.
        status: of its end.
        parts: into which the driven motion was divided.
    """

    start: FloatArray
    memory: ContactMemory
    x_hat: FloatArray
    target: FloatArray
    load_n: FloatArray
    held: FloatArray
    effort: _Effort
    near: Candidates | None = None
    status: StepStatus = StepStatus.NOT_CONVERGED
    parts: int = 1

    def towards(
        self,
        waypoint: FloatArray,
        *,
        escapes_saddle: bool = False,
        relaxes: bool = False,
        guesses: bool = False,
    ) -> IpcStep:
        """Return the step with other targets of the prescribed nodes."""
        held = self.load_n + self.held
        return IpcStep(self.start, self.memory, self.x_hat, waypoint, escapes_saddle, relaxes, guesses, held)


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
        before, effort = self.state(), _Effort()
        attempt = self._advance(target, load_n, effort, self._solve)
        if attempt.status is StepStatus.NOT_CONVERGED and self._model.parameters.remembers_slip:
            attempt = self._advance_in_shorter_steps(before, target, load_n, effort)
        if attempt.status is StepStatus.NOT_CONVERGED:
            self.restore(before)
            attempt = self._advance(target, load_n, effort, self._continue)
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
        effort: _Effort,
        solve: Callable[[_Attempt], tuple[StepStatus, int]],
        friction: float = 1.0,
    ) -> _Attempt:
        """Move the prescribed nodes to their targets in an IPC step that is solved as given; return how that ended.

        `friction` is the part of it that is left.
        """
        self._couple_touching_gels()
        start, time_step_s = self._x.copy(), self._time_step_s
        attempt = _Attempt(
            start=start,
            memory=self._memory,
            x_hat=start + time_step_s * self._velocity,
            target=target,
            load_n=load_n,
            held=np.zeros_like(start),
            effort=effort,
        )
        self._last_start = start, self._memory
        self._take_friction(friction)
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
        self, before: SceneState, target: FloatArray, load_n: FloatArray, effort: _Effort
    ) -> _Attempt:
        """Play an IPC step as several shorter ones, which remember what slips in each, until all are solved.

        A balance with strong friction may not exist where a long step is said to lead, and exist along the way.
        """
        whole_s, start = self._time_step_s, before.positions_m
        for count in _SHORTER_STEPS:
            self.restore(before)
            self._set_time_step(whole_s / count)
            for part in range(1, count + 1):
                attempt = self._advance(start + (part / count) * (target - start), load_n, effort, self._solve)
                if attempt.status is StepStatus.NOT_CONVERGED:
                    break
            else:
                attempt.status, attempt.parts = StepStatus.SHORTENED, count
                break
        self._set_time_step(whole_s)
        return attempt

    def _give_way(self, before: SceneState, target: FloatArray, load_n: FloatArray, effort: _Effort) -> _Attempt:
        """Play an IPC step with less and less friction until it is solved; without any there is a least energy."""
        for part in _FRICTION_LEFT:
            self.restore(before)
            attempt = self._advance(target, load_n, effort, self._solve, friction=part)
            if attempt.status is not StepStatus.NOT_CONVERGED:
                attempt.status = StepStatus.GAVE_WAY
                break
        return attempt

    def _set_time_step(self, time_step_s: float) -> None:
        self._time_step_s = time_step_s
        self._branches = build_branches(self._gels, time_step_s)
        self._model = self._build_model()._replace(surfaces=self._model.surfaces)

    def _solve(self, attempt: _Attempt) -> tuple[StepStatus, int]:
        """Solve in one or more parts, by escaping a saddle or relaxing; how, and in how many parts."""
        s = self._solver
        if isinstance(s, CutOffSolverSettings):
            step = attempt.towards(attempt.target)
            is_solved = self._solve_motion(attempt, step, iterations=s.iterations_per_step) == SOLVED
            return (StepStatus.CONVERGED if is_solved else StepStatus.CUT_OFF), 1
        if self._continues_motion(attempt):
            guess = attempt.towards(attempt.target, guesses=True)
            outcome = self._solve_motion(attempt, guess, iterations=s.phase_iterations)
            if outcome == SOLVED:
                return StepStatus.CONVERGED, 1
        unstable: tuple[FloatArray, int] | None = None
        for parts in (2**level for level in range(s.first_division_level, s.division_levels + 1)):
            outcome = self._solve_in_parts(attempt, parts)
            if outcome == SOLVED:
                return StepStatus.DIVIDED if parts > 1 else StepStatus.CONVERGED, parts
            if outcome == UNSTABLE and unstable is None:
                unstable = self._x.copy(), parts
        if unstable is not None and s.saddle_escapes > 0:
            self._x[:], parts = unstable
            if self._escape_saddles(attempt):
                return StepStatus.ESCAPED_SADDLE, parts
        self._x[:] = attempt.start
        if self._solve_motion(attempt, attempt.towards(attempt.target, relaxes=True)) == SOLVED:
            return StepStatus.RELAXED, 1
        return StepStatus.NOT_CONVERGED, 1

    def _continue(self, attempt: _Attempt) -> tuple[StepStatus, int]:
        """Solve by following balances from the start; as `_solve`."""
        is_solved = self._continue_from_start(attempt) or self._follow_path(attempt)
        return (StepStatus.CONTINUED if is_solved else StepStatus.NOT_CONVERGED), 1

    def _continues_motion(self, attempt: _Attempt) -> bool:
        """Return whether the driven nodes move about as in the IPC step before, in which no node went much further."""
        if not self._model.parameters.remembers_slip:
            return False
        before_m, prescribed = attempt.x_hat - attempt.start, self._model.unknowns.slot == PRESCRIBED
        driven_m = (attempt.target - attempt.start)[prescribed]
        largest_m = np.abs(driven_m).max()
        differs = np.abs(driven_m - before_m[prescribed]).max() >= _LARGEST_CHANGE * largest_m
        return bool(not differs and np.abs(before_m).max() < _LONGEST_FOLLOWING * largest_m)

    def _solve_in_parts(self, attempt: _Attempt, parts: int) -> int:
        """Solve along intermediate driven positions, each from the solution of the one before; how the last one ended.

        An intermediate one that ends without a stable solution is the last one, and counts as not solved.
        """
        self._x[:] = attempt.start
        for part in range(1, parts):
            waypoint = attempt.start + (part / parts) * (attempt.target - attempt.start)
            if self._solve_motion(attempt, attempt.towards(waypoint)) != SOLVED:
                return UNSOLVED
        return self._solve_motion(attempt, attempt.towards(attempt.target))

    def _escape_saddles(self, attempt: _Attempt) -> bool:
        """Leave the unstable equilibrium that the scene is in, and any that this leads to."""
        for _ in range(self._solver.saddle_escapes):
            attempt.effort.saddle_escapes += 1
            outcome = self._solve_motion(attempt, attempt.towards(attempt.target, escapes_saddle=True))
            if outcome != UNSTABLE:
                return outcome == SOLVED
        return False

    def _continue_from_start(self, attempt: _Attempt) -> bool:
        """Follow balances along the step: at its start forces are held that make this one, at its end none.

        The strides halve where one leads to no stable balance; the shortest ones jump to the next by relaxing.
        """
        self._x[:] = attempt.start
        unbalanced = forces_at(self._model, self._x, attempt.towards(attempt.start), self._workspace)
        residual_n = max(self._solver.residual_tolerance_n, _UNBALANCED_PART * float(np.abs(unbalanced).max()))
        part, stride, solved_before = 0.0, _FIRST_STRIDE, False
        for _ in range(_MOST_STRIDES):
            before, following = self._x.copy(), min(1.0, part + stride)
            waypoint = attempt.start + following * (attempt.target - attempt.start)
            attempt.held, shortest = (1.0 - following) * unbalanced, stride <= _SHORTEST_STRIDE
            step = attempt.towards(waypoint, relaxes=shortest)
            if self._solve_motion(attempt, step, residual_n=residual_n) == SOLVED:
                part, stride, solved_before = following, 2.0 * stride if solved_before else stride, True
            elif shortest:
                break
            else:
                self._x[:], stride, solved_before = before, 0.5 * stride, False
            if part == 1.0:
                return True
        attempt.held = np.zeros_like(unbalanced)
        return self._solve_motion(attempt, attempt.towards(attempt.target)) == SOLVED

    def _follow_path(self, attempt: _Attempt) -> bool:
        """Follow the path of balances from the start, also where it turns back; the state stays where that fails."""
        before, step = self._x.copy(), attempt.towards(attempt.target)
        self._x[:] = attempt.start
        unbalanced = forces_at(self._model, self._x, attempt.towards(attempt.start), self._workspace)
        path = BalancePath(self._model, self._x, step, unbalanced, self._workspace)
        arrived = path.follow(_PATH_ITERATIONS * self._solver.newton_iterations)
        attempt.effort.record.counts[Counter.ITERATIONS] += path.iterations
        if arrived and self._solve_motion(attempt, step) == SOLVED:
            return True
        self._x[:] = before
        left_n = forces_at(self._model, self._x, step, self._workspace)[self._model.unknowns.node]
        residual_n = float(np.sqrt((left_n * left_n).sum(axis=1)).max())
        attempt.effort.record.measures[:] = residual_n, *self._workspace.smallest
        return False

    def _solve_motion(
        self,
        attempt: _Attempt,
        step: IpcStep,
        *,
        iterations: int | None = None,
        residual_n: float | None = None,
    ) -> int:
        s = self._solver
        most = s.newton_iterations if iterations is None else iterations
        residual_n = s.residual_tolerance_n if residual_n is None else residual_n
        tolerances = Tolerances(s.step_tolerance_m, residual_n, most, s.phase_iterations)
        outcome, attempt.near = solve_step(
            self._model, self._x, step, tolerances, self._workspace, attempt.effort.record
        )
        return outcome

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
