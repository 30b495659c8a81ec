"""A scene: gels and affine bodies that are stepped together, one IPC step at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from .affine_body import frame_mass, frame_weights
from .linear_system import SystemLayout, gel_block_places, system_layout
from .mesh import GelMesh, SurfaceMesh
from .model import (
    PRESCRIBED,
    Affine,
    Elastic,
    Model,
    Parameters,
    Points,
    Surfaces,
    Unknowns,
)
from .neo_hookean import lame_parameters_pa
from .newton import Counter, Measure, Tolerances, solve_step
from .overlap import find_overlap
from .points import point_positions
from .workspace import new_workspace

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class SceneError(VitacError):
    """A scene cannot be built or stepped as asked; the message says what was expected and what came."""


class StepStatus(StrEnum):
    """How an IPC step ended."""

    CONVERGED = "converged"  # solved in one go
    SUBSTEPPED = "substepped"  # solved after the driven motion was divided
    NOT_CONVERGED = "not_converged"  # not solved; the state is free of intersections but is not a minimum


@dataclass(frozen=True, kw_only=True, eq=False)
class GelBody:
    """A gel in a scene, placed by world = rotation @ rest + translation.

    Attributes:
        mesh: tetrahedral mesh.
        rotation: shape [3, 3].
        translation_m: [m], shape [3].
        youngs_modulus_pa: Young's modulus [Pa].
        poisson_ratio: Poisson's ratio [-].
        density_kg_m3: density [kg/m^3].
        friction: friction coefficient [-]; a pair of bodies uses the mean of its two.
    """

    mesh: GelMesh
    rotation: FloatArray
    translation_m: FloatArray
    youngs_modulus_pa: float = 3e5
    poisson_ratio: float = 0.3
    density_kg_m3: float = 1000.0
    friction: float = 87.5


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """A rigid part in a scene (an affine body), placed by world = rotation @ body + translation.

    A fixed one never moves.
    """

    mesh: SurfaceMesh
    rotation: FloatArray
    translation_m: FloatArray
    density_kg_m3: float = 500.0
    friction: float = 1.0
    fixed: bool = False


@dataclass(frozen=True, kw_only=True)
class ContactSettings:
    """Contact of all pairs of different bodies; defaults are the peg task's (challenge-facts 3).

    Attributes:
        d_hat_m: distance at which the barrier sets in [m].
        kappa: barrier stiffness, times h^2 [N s^2 / m].
        kappa_affine: stiffness of the orthogonality energy [Pa s^2].
        friction_velocity_m_s: sliding speed at which friction is fully developed, eps_v [m/s].
        ccd_gap_fraction: part of a gap that one Newton iteration may close.
    """

    d_hat_m: float = 1e-4
    kappa: float = 100.0
    kappa_affine: float = 1e5
    friction_velocity_m_s: float = 0.01
    ccd_gap_fraction: float = 0.7


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """The `converged` profile: when an IPC step counts as solved.

    Attributes:
        step_tolerance_m: largest move of the last Newton iteration [m].
        residual_tolerance_n: largest force left on a node, friction taken at the solution [N].
        newton_iterations: most Newton iterations of one solve.
        phase_iterations: length of a turn of free Newton iterations, and of the first cautious one.
        first_substep_level: how often the driven motion is halved from the start.
        substep_levels: how often the driven motion may be halved when a step does not converge.
        candidate_margin_m: relative motion that a list of candidate pairs stays good for [m].
    """

    step_tolerance_m: float = 1e-8
    residual_tolerance_n: float = 1e-4
    newton_iterations: int = 228
    phase_iterations: int = 12
    first_substep_level: int = 0
    substep_levels: int = 4
    candidate_margin_m: float = 2e-4


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What one IPC step took and left.

    Attributes:
        status: how it ended; a caller must not go on after NOT_CONVERGED.
        newton_iterations: Newton iterations, all sub-steps together.
        substeps: parts the driven motion was divided into.
        projected_iterations: iterations whose Hessian had to be projected to be positive definite.
        unstable_solutions: equilibria that were refused because the determinant of their Jacobian is negative.
        residual_n: largest force left on a node [N].
        net_force_n: largest net force left on a movable body [N].
        net_torque_n_m: largest net torque left on a movable body, about its centroid [N m].
        smallest_gap_m: smallest distance of two bodies [m]; infinite when nothing is within d_hat.
        smallest_det_f: smallest det F of all tetrahedra.
        active_contacts: pairs closer than d_hat.
    """

    status: StepStatus
    newton_iterations: int
    substeps: int
    projected_iterations: int
    unstable_solutions: int
    residual_n: float
    net_force_n: float
    net_torque_n_m: float
    smallest_gap_m: float
    smallest_det_f: float
    active_contacts: int


class Scene:
    """Steps gels and affine bodies through driven motions, each step solved to convergence.

    Raises:
        SceneError: a body is misplaced, bodies overlap at the start, or a setting is out of range.
    """

    def __init__(
        self,
        *,
        gels: Sequence[GelBody],
        bodies: Sequence[RigidBody],
        time_step_s: float,
        contact: ContactSettings | None = None,
        solver: SolverSettings | None = None,
    ) -> None:
        self._gels = tuple(gels)
        self._bodies = tuple(bodies)
        self._contact = contact or ContactSettings()
        self._solver = solver or SolverSettings()
        if not self._gels:
            raise SceneError("A scene needs at least one gel, got none.")
        self._layout = _Layout(self._gels, self._bodies)
        self._model = _build_model(
            self._gels,
            self._bodies,
            self._layout,
            time_step_s,
            self._contact,
            self._solver,
        )
        self._x = self._layout.initial_positions_m()
        self._workspace = new_workspace(self._model.system, len(self._x))
        self._velocity = np.zeros_like(self._x)
        self._refuse_overlap()

    def step(self, *, driven_targets_m: Sequence[FloatArray]) -> StepReport:
        """Advance one time step while the driven nodes of each gel move to their targets [m], shapes [d, 3].

        The state after NOT_CONVERGED is free of intersections and inversions but is no minimum.
        """
        target = self._target(driven_targets_m)
        start = self._x.copy()
        x_hat = start + self._model.parameters.time_step_s * self._velocity
        counts = np.zeros(len(Counter), dtype=np.int64)
        measures = np.zeros(len(Measure))
        substeps, solved = 1, False
        for level in range(self._solver.first_substep_level, self._solver.substep_levels + 1):
            substeps = 2**level
            self._x[:] = start
            solved = self._solve_in_parts(substeps, start, x_hat, target, counts, measures)
            if solved:
                break
        self._velocity = (self._x - start) / self._model.parameters.time_step_s
        force, torque = self._net_load(self._workspace.gradient)
        status = StepStatus.NOT_CONVERGED
        if solved:
            status = StepStatus.CONVERGED if substeps == 1 else StepStatus.SUBSTEPPED
        return StepReport(
            status=status,
            newton_iterations=int(counts[Counter.ITERATIONS]),
            substeps=substeps,
            projected_iterations=int(counts[Counter.PROJECTED_ITERATIONS]),
            unstable_solutions=int(counts[Counter.UNSTABLE]),
            residual_n=float(measures[Measure.RESIDUAL_N]),
            net_force_n=force,
            net_torque_n_m=torque,
            smallest_gap_m=float(measures[Measure.SMALLEST_GAP_M]),
            smallest_det_f=float(measures[Measure.SMALLEST_DET_F]),
            active_contacts=int(counts[Counter.ACTIVE_CONTACTS]),
        )

    def gel_positions_m(self, index: int) -> FloatArray:
        """World positions of a gel's nodes [m], shape [n, 3] (a copy)."""
        return self._x[self._layout.gel_slices[index]].copy()

    def body_vertices_m(self, index: int) -> FloatArray:
        """World positions of a rigid body's vertices [m], shape [v, 3] (a copy)."""
        frame = self._x[self._layout.body_slices[index]]
        weights = self._layout.body_weights[index]
        return np.asarray((weights[:, :, None] * frame[None, :, :]).sum(axis=1))

    def state_bytes(self) -> bytes:
        """All positions and velocities as little-endian float64, for hashing."""
        return self._x.astype("<f8").tobytes() + self._velocity.astype("<f8").tobytes()

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

    def _target(self, driven_targets_m: Sequence[FloatArray]) -> FloatArray:
        if len(driven_targets_m) != len(self._gels):
            raise SceneError(f"Got driven targets for {len(driven_targets_m)} gels, expected {len(self._gels)}.")
        target = self._x.copy()
        for index, (gel, wanted) in enumerate(zip(self._gels, driven_targets_m, strict=True)):
            expected = (len(gel.mesh.driven_nodes), 3)
            if wanted.shape != expected or not np.isfinite(wanted).all():
                raise SceneError(
                    f"Driven targets of gel {index} have shape {wanted.shape}, expected {expected} finite numbers [m]."
                )
            target[self._layout.gel_slices[index]][gel.mesh.driven_nodes] = wanted
        return target

    def _solve_in_parts(
        self,
        parts: int,
        start: FloatArray,
        x_hat: FloatArray,
        target: FloatArray,
        counts: IndexArray,
        measures: FloatArray,
    ) -> bool:
        """Solve the same IPC step along intermediate driven positions, each from the solution of the one before."""
        s = self._solver
        tolerances = Tolerances(
            s.step_tolerance_m,
            s.residual_tolerance_n,
            s.newton_iterations,
            s.phase_iterations,
        )
        for part in range(1, parts + 1):
            waypoint = target if part == parts else start + (part / parts) * (target - start)
            if not solve_step(
                self._model,
                self._x,
                start,
                x_hat,
                waypoint,
                tolerances,
                counts,
                measures,
                self._workspace,
            ):
                return False
        return True

    def _net_load(self, gradient: FloatArray) -> tuple[float, float]:
        """Largest net force [N] and torque [N m] left on a movable body; frame point forces act at the frame points."""
        force, torque = 0.0, 0.0
        for body, rows in zip(self._bodies, self._layout.body_slices, strict=True):
            if not body.fixed:
                loads, arms = gradient[rows], self._x[rows] - self._x[rows][0]
                force = max(force, float(np.sqrt((loads.sum(axis=0) ** 2).sum())))
                torque = max(
                    torque,
                    float(np.sqrt((np.cross(arms, loads).sum(axis=0) ** 2).sum())),
                )
        return force, torque


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where the bodies' nodes stand in the scene's node array."""

    gels: tuple[GelBody, ...]
    bodies: tuple[RigidBody, ...]
    gel_slices: list[slice] = field(init=False, default_factory=list)
    body_slices: list[slice] = field(init=False, default_factory=list)
    body_weights: list[FloatArray] = field(init=False, default_factory=list)
    body_centroids_m: list[FloatArray] = field(init=False, default_factory=list)
    body_lengths_m: list[float] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        count = 0
        for gel in self.gels:
            self.gel_slices.append(slice(count, count + len(gel.mesh.rest_position_m)))
            count += len(gel.mesh.rest_position_m)
        for body in self.bodies:
            volume, first, _ = body.mesh.moments
            centroid = first / volume
            length = float(np.abs(body.mesh.vertices_m - centroid).max())
            self.body_slices.append(slice(count, count + 4))
            self.body_centroids_m.append(centroid)
            self.body_lengths_m.append(length)
            self.body_weights.append(frame_weights(body.mesh.vertices_m, centroid, length))
            count += 4

    def initial_positions_m(self) -> FloatArray:
        """Node positions [m] of shape [n, 3] as the bodies were placed."""
        parts = [_placed(gel.mesh.rest_position_m, gel) for gel in self.gels]
        for body, centroid, length in zip(self.bodies, self.body_centroids_m, self.body_lengths_m, strict=True):
            frame = centroid + length * np.concatenate([np.zeros((1, 3)), np.eye(3)])
            parts.append(_placed(frame, body))
        return np.concatenate(parts)


def _placed(points_m: FloatArray, body: GelBody | RigidBody) -> FloatArray:
    """Points in the world: rotation @ point + translation, without BLAS."""
    return np.asarray((body.rotation[None, :, :] * points_m[:, None, :]).sum(axis=2) + body.translation_m)


def _build_model(
    gels: tuple[GelBody, ...],
    bodies: tuple[RigidBody, ...],
    layout: _Layout,
    time_step_s: float,
    contact: ContactSettings,
    solver: SolverSettings,
) -> Model:
    h2 = time_step_s * time_step_s
    unknowns, system = _build_unknowns(gels, bodies, layout)
    return Model(
        elastic=_build_elastic(gels, layout, unknowns, system),
        affine=_build_affine(bodies, layout, unknowns, contact.kappa_affine / h2),
        points=_build_points(gels, bodies, layout),
        surfaces=_build_surfaces(gels, bodies),
        unknowns=unknowns,
        system=system,
        parameters=Parameters(
            time_step_s=time_step_s,
            d_hat_m=contact.d_hat_m,
            barrier_stiffness_n_m=contact.kappa / h2,
            slip_scale_m=contact.friction_velocity_m_s * time_step_s,
            ccd_gap_fraction=contact.ccd_gap_fraction,
            candidate_margin_m=solver.candidate_margin_m,
        ),
    )


def _build_elastic(gels: tuple[GelBody, ...], layout: _Layout, unknowns: Unknowns, system: SystemLayout) -> Elastic:
    nodes, gradients, volumes, mu, lam = [], [], [], [], []
    for gel, rows in zip(gels, layout.gel_slices, strict=True):
        corners = gel.mesh.rest_position_m[gel.mesh.tetrahedra]
        mu_pa, lambda_pa = lame_parameters_pa(gel.youngs_modulus_pa, gel.poisson_ratio)
        nodes.append(gel.mesh.tetrahedra + rows.start)
        gradients.append(_rotated_gradients(corners, gel.rotation))
        volumes.append(gel.mesh.volumes_m3)
        mu.append(np.full(len(corners), mu_pa))
        lam.append(np.full(len(corners), lambda_pa))
    all_nodes = np.concatenate(nodes)
    slots = unknowns.slot[all_nodes]
    first, second = np.repeat(slots, 4, axis=1), np.tile(slots, 4)
    return Elastic(
        nodes=all_nodes,
        gradients_1_m=np.concatenate(gradients),
        volume_m3=np.concatenate(volumes),
        mu_pa=np.concatenate(mu),
        lambda_pa=np.concatenate(lam),
        places=gel_block_places(system.neighbours, first, second),
        reaction=(first == PRESCRIBED) != (second == PRESCRIBED),
    )


def _rotated_gradients(corners_m: FloatArray, rotation: FloatArray) -> FloatArray:
    """Rest gradients of the shape functions [1/m], shape [t, 4, 3], in the frame the gel was placed in.

    The gradient of node a is the inward normal of the face opposite to it, over 6 V.
    """
    e1, e2, e3 = (corners_m[:, i] - corners_m[:, 0] for i in (1, 2, 3))
    six_volumes = (e1 * np.cross(e2, e3)).sum(axis=1)[:, None]
    inner = np.stack([np.cross(e2, e3), np.cross(e3, e1), np.cross(e1, e2)], axis=1) / six_volumes[:, None]
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    return np.asarray((rotation[None, None, :, :] * gradients[:, :, None, :]).sum(axis=3))


def _build_affine(
    bodies: tuple[RigidBody, ...],
    layout: _Layout,
    unknowns: Unknowns,
    kappa_over_h2: float,
) -> Affine:
    movable = [i for i, body in enumerate(bodies) if not body.fixed]
    masses = [
        frame_mass(
            bodies[i].mesh,
            layout.body_centroids_m[i],
            layout.body_lengths_m[i],
            bodies[i].density_kg_m3,
        )
        for i in movable
    ]
    first_node = np.array([layout.body_slices[i].start for i in movable], dtype=np.int64)
    return Affine(
        first_node=first_node,
        first_unknown=unknowns.slot[first_node],
        frame_length_m=np.array([layout.body_lengths_m[i] for i in movable]),
        mass_kg=np.stack(masses) if masses else np.empty((0, 4, 4)),
        stiffness_j=np.array([kappa_over_h2 * bodies[i].mesh.volume_m3 for i in movable]),
    )


def _build_points(gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], layout: _Layout) -> Points:
    nodes, weights, counts = [], [], []
    for gel, rows in zip(gels, layout.gel_slices, strict=True):
        surface = gel.mesh.surface_nodes + rows.start
        nodes.append(np.repeat(surface[:, None], 4, axis=1))
        weights.append(np.tile([1.0, 0.0, 0.0, 0.0], (len(surface), 1)))
        counts.append(np.ones(len(surface), dtype=np.int64))
    for body, rows, body_weights in zip(bodies, layout.body_slices, layout.body_weights, strict=True):
        vertices = len(body.mesh.vertices_m)
        nodes.append(np.tile(np.arange(rows.start, rows.start + 4), (vertices, 1)))
        weights.append(body_weights)
        counts.append(np.full(vertices, 4, dtype=np.int64))
    return Points(np.concatenate(nodes), np.concatenate(weights), np.concatenate(counts))


def _build_surfaces(gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...]) -> Surfaces:
    point_start, edge_start, triangle_start = [0], [0], [0]
    edges, lengths, triangles = [], [], []
    members = [(*gel.mesh.surface, gel.mesh.surface_edges) for gel in gels]
    members += [(body.mesh.vertices_m, body.mesh.triangles, body.mesh.edges) for body in bodies]
    for rest, body_triangles, body_edges in members:
        vectors = rest[body_edges[:, 1]] - rest[body_edges[:, 0]]
        edges.append(body_edges + point_start[-1])
        lengths.append((vectors**2).sum(axis=1))
        triangles.append(body_triangles + point_start[-1])
        point_start.append(point_start[-1] + len(rest))
        edge_start.append(edge_start[-1] + len(body_edges))
        triangle_start.append(triangle_start[-1] + len(body_triangles))
    pairs, friction = _touching_pairs(gels, bodies)
    return Surfaces(
        point_start=np.array(point_start, dtype=np.int64),
        edges=np.concatenate(edges),
        edge_start=np.array(edge_start, dtype=np.int64),
        edge_squared_length_m2=np.concatenate(lengths),
        triangles=np.concatenate(triangles),
        triangle_start=np.array(triangle_start, dtype=np.int64),
        pairs=pairs,
        pair_friction=friction,
    )


def _touching_pairs(gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...]) -> tuple[IndexArray, FloatArray]:
    """Pairs of different bodies of which at least one can move, and the mean of their friction coefficients."""
    members: list[GelBody | RigidBody] = [*gels, *bodies]
    pairs, friction = [], []
    for a, first in enumerate(members):
        for b in range(a + 1, len(members)):
            second = members[b]
            if isinstance(first, RigidBody) and first.fixed and isinstance(second, RigidBody) and second.fixed:
                continue
            pairs.append((a, b))
            friction.append(0.5 * (first.friction + second.friction))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(friction)


def _build_unknowns(
    gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], layout: _Layout
) -> tuple[Unknowns, SystemLayout]:
    total = layout.body_slices[-1].stop if bodies else layout.gel_slices[-1].stop
    slot = np.full(total, PRESCRIBED, dtype=np.int64)
    mass = np.zeros(total)
    order: list[int] = []
    for gel, rows in zip(gels, layout.gel_slices, strict=True):
        np.add.at(
            mass,
            gel.mesh.tetrahedra + rows.start,
            0.25 * gel.density_kg_m3 * gel.mesh.volumes_m3[:, None],
        )
        order.extend((gel.mesh.elimination.nodes + rows.start).tolist())
    gel_unknowns = len(order)
    for body, rows in zip(bodies, layout.body_slices, strict=True):
        if not body.fixed:
            order.extend(range(rows.start, rows.stop))
    slot[order] = np.arange(len(order))
    system = system_layout([gel.mesh.elimination for gel in gels], len(order) - gel_unknowns)
    return Unknowns(slot=slot, node=np.array(order, dtype=np.int64), node_mass_kg=mass), system
