"""A second solver of the grasp, slow and plain, to compare the engine with; it shares no kernel with `vitac.envs.fem`.

It finds the same balance of forces (docs/physics.md) by other means: rigid parts in the unknowns (A, t) of x = A X + t,
distances, closest points, barrier, mollifier, collisions and impact times from the IPC Toolkit, elasticity by numpy,
the derivative of every contact's force by differences, and sparse LU with row exchanges.
"""

from dataclasses import dataclass
from typing import Any

import ipctk  # type: ignore[import-not-found]
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.fem.model.settings import ContactSettings
from vitac.envs.scene.grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Matrix = Any  # a scipy sparse array

# Bodies in the order in which the oracle counts them.
LEFT_GEL, RIGHT_GEL, HELD, FIXED = range(4)

# Solved: largest force left [N] (on A: [N m] over 1 m) and largest last move [m].
_FORCE_TOLERANCE_N = 1e-6
_MOVE_TOLERANCE_M = 1e-10
_ITERATIONS = 100
_LONGEST_MOVE_M = 1e-3
# Part of the way to an impact that one iteration may go.
_PART_TO_IMPACT = 0.8
# Step of the differences, small against every gap that occurs (1 to 100 micrometres) [m].
_DIFFERENCE_M = 1e-9


class OracleFailed(AssertionError):
    """The oracle found no solution, so there is nothing to compare with."""


class SlowOracle:
    """Two gels, the part between them and the fixed part, starting from where a `GraspedScene` has placed them.

    All coordinates stand in one vector X: nodes of both gels, then t, then A by rows. The vertices that can touch are
    at S X + constant.
    """

    def __init__(self, grasped: GraspedScene) -> None:
        gel, held, physics = grasped.gel, grasped.held, grasped.physics
        contact = physics.contact
        assert isinstance(contact, ContactSettings), "the oracle knows the model challenge-2025 only"
        self._h = physics.time_step_s
        rest_m = np.concatenate([grasped.gel_nodes_m(0), grasped.gel_nodes_m(1)])
        nodes = len(gel.rest_position_m)
        tetrahedra = np.concatenate([gel.tetrahedra, gel.tetrahedra + nodes])
        driven = np.concatenate([gel.driven_nodes, gel.driven_nodes + nodes])
        self._elasticity = _Elasticity(rest_m, tetrahedra, physics.youngs_modulus_pa, physics.poisson_ratio)
        self._body = _AffineBody(grasped.held_surface, held.density_kg_m3, contact.kappa_affine / self._h**2)
        self._contacts = _Contacts(grasped, contact)
        self._mass = sparse.block_diag([self._elasticity.mass(physics.gel_density_kg_m3), self._body.mass])
        self.X = np.concatenate([rest_m.ravel(), held.translation_m, held.rotation.ravel()])
        self._velocity = np.zeros_like(self.X)
        self._driven = _coordinates(driven).ravel()
        self._free = np.setdiff1d(np.arange(len(self.X)), self._driven)

    def gel_nodes_m(self, index: int) -> FloatArray:
        """World positions of all nodes of a gel [m], shape [n, 3]."""
        return np.asarray(self.X[:-12].reshape(2, -1, 3)[index])

    def held_vertices_m(self) -> FloatArray:
        """World positions of the vertices of the held part [m], shape [v, 3]."""
        return self._body.vertices_m(self.X[-12:])

    def touching(self, first: int, second: int) -> int:
        """Pairs of two bodies closer than d_hat."""
        return self._contacts.touching(self.X, first, second)

    def step(self, driven_targets_m: FloatArray) -> None:
        """One IPC step, the driven nodes of both gels going to these positions [m], by Newton's method.

        Raises:
            OracleFailed: Newton's method did not get there.
        """
        start, target = self.X, driven_targets_m.ravel()
        X, predicted = start, start + self._h * self._velocity
        for _ in range(_ITERATIONS):
            force, jacobian = self._forces(X, start, predicted)
            left, rows = target - X[self._driven], jacobian[self._free]
            move = np.zeros_like(X)
            move[self._driven] = left
            move[self._free] = splu(rows[:, self._free].tocsc()).solve(
                -force[self._free] - rows[:, self._driven] @ left
            )
            longest = self._contacts.longest_motion_m(move)
            largest_n = float(np.abs(force[self._free]).max())
            if not left.any() and largest_n <= _FORCE_TOLERANCE_N and longest <= _MOVE_TOLERANCE_M:
                self.X, self._velocity = X, (X - start) / self._h
                return
            part = self._allowed_part(X, move, min(1.0, _LONGEST_MOVE_M / longest))
            X = X + part * move
            if part == 1.0:
                X[self._driven] = target
        raise OracleFailed(f"No solution in {_ITERATIONS} iterations, {largest_n} N are left.")

    def _forces(self, X: FloatArray, start: FloatArray, predicted: FloatArray) -> tuple[FloatArray, Matrix]:
        """All forces dE/dX, friction included, and their derivative."""
        elastic, stiffness = self._elasticity.forces(X[:-12])
        round_, round_stiffness = self._body.orthogonality(X[-12:])
        contact, contact_stiffness = self._contacts.forces(X, start, self._h)
        force = np.concatenate([elastic, round_]) + self._mass @ (X - predicted) / self._h**2 + contact
        jacobian = sparse.block_diag([stiffness, round_stiffness]) + self._mass / self._h**2 + contact_stiffness
        return force, sparse.csr_array(jacobian)

    def _allowed_part(self, X: FloatArray, move: FloatArray, part: float) -> float:
        """Part of a move that neither makes bodies collide nor turns a tetrahedron inside out."""
        impact = self._contacts.time_of_impact(X, X + part * move)
        if impact < 1.0:
            part *= _PART_TO_IMPACT * impact
        while self._elasticity.smallest_determinant((X + part * move)[:-12]) <= 0:
            part *= 0.5
        return part


class _Elasticity:
    """psi(F) = mu/2 (tr F'F - 3) - mu ln J + lambda/2 (ln J)^2 over all tetrahedra."""

    def __init__(self, rest_m: FloatArray, tetrahedra: IndexArray, young_pa: float, poisson: float) -> None:
        self._mu = young_pa / (2 * (1 + poisson))
        self._lambda = young_pa * poisson / ((1 + poisson) * (1 - 2 * poisson))
        corners = rest_m[tetrahedra]
        edges = np.transpose(corners[:, 1:] - corners[:, :1], (0, 2, 1))
        self._volumes_m3 = np.linalg.det(edges) / 6
        inverse = np.linalg.inv(edges)
        # F = sum_a x_a g_a^T.
        self._g = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        # Change of F by each of the 12 coordinates, dF[t, (a, i)] = e_i g_a^T.
        self._dF = np.einsum("ki,taj->takij", np.eye(3), self._g).reshape(-1, 12, 3, 3)
        self._places = _coordinates(tetrahedra).reshape(-1, 12)
        self._count = rest_m.size

    def mass(self, density_kg_m3: float) -> Matrix:
        """A quarter of a tetrahedron's mass at each of its corners."""
        lumped = np.zeros(self._count)
        np.add.at(lumped, self._places, density_kg_m3 * self._volumes_m3[:, None] / 4)
        return sparse.diags_array(lumped)

    def smallest_determinant(self, x: FloatArray) -> float:
        return float(np.linalg.det(self._deformation(x)).min())

    def forces(self, x: FloatArray) -> tuple[FloatArray, Matrix]:
        F = self._deformation(x)
        inverse, log_j = np.linalg.inv(F), np.log(np.linalg.det(F))[:, None, None]
        inverse_t = np.transpose(inverse, (0, 2, 1))
        stress = self._mu * (F - inverse_t) + self._lambda * log_j * inverse_t
        force = np.zeros(self._count)
        np.add.at(force, self._places, np.einsum("t,tij,tcij->tc", self._volumes_m3, stress, self._dF))
        # d(F^-T) = -F^-T dF^T F^-T
        turned = np.einsum("tji,tckj,tlk->tcil", inverse, self._dF, inverse)
        stretched = np.einsum("tji,tcij->tc", inverse, self._dF)[:, :, None, None]
        change = self._mu * self._dF + (self._mu - self._lambda * log_j)[:, None] * turned
        change += self._lambda * stretched * inverse_t[:, None]
        blocks = np.einsum("t,tcij,tbij->tbc", self._volumes_m3, change, self._dF)
        return force, _summed(self._places, blocks, self._count)

    def _deformation(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("tc,tcij->tij", x[self._places], self._dF))


class _AffineBody:
    """The held part in the unknowns q = (t, A by rows)."""

    def __init__(self, mesh: SurfaceMesh, density_kg_m3: float, stiffness_pa: float) -> None:
        self._vertices = mesh.vertices_m
        # Moments, from the tetrahedra that the triangles make with the origin.
        corners = mesh.vertices_m[mesh.triangles]
        volumes, sums = np.linalg.det(corners) / 6, corners.sum(axis=1)
        first = volumes @ sums / 4
        second = np.einsum("t,tai,taj->ij", volumes, corners, corners) + np.einsum("t,ti,tj->ij", volumes, sums, sums)
        moments = np.block([[np.full((1, 1), volumes.sum()), first[None]], [first[:, None], second / 20]])
        self.mass = np.zeros((12, 12))
        for i in range(3):
            place = [i, 3 + 3 * i, 4 + 3 * i, 5 + 3 * i]
            self.mass[np.ix_(place, place)] = density_kg_m3 * moments
        self._stiffness_j = stiffness_pa * float(volumes.sum())

    def vertices_m(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._vertices @ q[3:].reshape(3, 3).T + q[:3])

    def vertex_rows(self) -> FloatArray:
        """Derivative of all vertices by q, shape [3 v, 12]."""
        return np.concatenate([np.hstack([np.eye(3), np.kron(np.eye(3), v)]) for v in self._vertices])

    def orthogonality(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (kappa_affine V / h^2) |A A' - I|^2."""
        A = q[3:].reshape(3, 3)
        error = A @ A.T - np.eye(3)
        force, hessian = np.zeros(12), np.zeros((12, 12))
        force[3:] = 4 * self._stiffness_j * (error @ A).ravel()
        for k, dA in enumerate(np.eye(9).reshape(9, 3, 3)):
            hessian[3:, 3 + k] = 4 * self._stiffness_j * (error @ dA + (dA @ A.T + A @ dA.T) @ A).ravel()
        return force, hessian


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """Two primitives that may touch: what the IPC Toolkit knows them by, and what the force law needs."""

    stencil: Any  # ipctk.CollisionStencil
    vertices: IndexArray
    bodies: tuple[int, int]
    friction: float
    mollifier_eps_m4: float | None  # None for point-triangle pairs


class _Contacts:
    """Barrier, mollifier and friction of all pairs, with geometry and laws from the IPC Toolkit."""

    def __init__(self, grasped: GraspedScene, settings: ContactSettings) -> None:
        ipctk.set_num_threads(1)
        self._settings = settings
        gel, held, fixed = grasped.gel, grasped.held, grasped.fixed
        fixed_m = fixed.mesh.vertices_m @ fixed.rotation.T + fixed.translation_m
        nodes = np.concatenate([gel.surface_nodes, gel.surface_nodes + len(gel.rest_position_m)])
        gel_rows = sparse.eye_array(6 * len(gel.rest_position_m), format="csr")[_coordinates(nodes).ravel()]
        held_rows = _AffineBody(grasped.held_surface, 1.0, 1.0).vertex_rows()
        moving = sparse.block_diag([gel_rows, held_rows])
        self._S = sparse.csr_array(sparse.vstack([moving, sparse.csr_array((fixed_m.size, moving.shape[1]))]))
        self._constant = np.concatenate([np.zeros(moving.shape[0]), fixed_m.ravel()])
        frictions = [grasped.physics.gel_friction] * 2 + [held.friction, fixed.friction]
        self._friction = 0.5 * np.add.outer(frictions, frictions)
        points, faces = gel.surface
        surfaces = [(len(points), faces), (len(points), faces)]
        surfaces += [(len(mesh.vertices_m), mesh.triangles) for mesh in (grasped.held_surface, fixed.mesh)]
        self._body = np.repeat(np.arange(4), [count for count, _ in surfaces])
        starts = np.searchsorted(self._body, np.arange(4))
        triangles = np.concatenate([faces + start for (_, faces), start in zip(surfaces, starts, strict=True)])
        edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        rest = np.concatenate([grasped.gel_nodes_m(0), grasped.gel_nodes_m(1)])[nodes]
        rest = np.concatenate([rest, grasped.held_surface.vertices_m, fixed_m])
        self._mesh = ipctk.CollisionMesh(
            *(np.asfortranarray(a) for a in (rest, edges.astype("i4"), triangles.astype("i4")))
        )
        self._mesh.can_collide = ipctk.make_vertex_patches_filter(self._body.astype("i4"))

    def longest_motion_m(self, move: FloatArray) -> float:
        """Largest component of a vertex's motion."""
        return float(np.abs(self._S @ move).max())

    def time_of_impact(self, X: FloatArray, X_end: FloatArray) -> float:
        """Part of the way that is free of collisions, 1 for all of it."""
        return float(ipctk.compute_collision_free_stepsize(self._mesh, self._vertices(X), self._vertices(X_end)))

    def touching(self, X: FloatArray, first: int, second: int) -> int:
        return sum(pair.bodies == (first, second) for pair in self._active_pairs(self._vertices(X)))

    def forces(self, X: FloatArray, start: FloatArray, h: float) -> tuple[FloatArray, Matrix]:
        y, y_start = self._vertices(X), self._vertices(start)
        pairs = self._active_pairs(y)
        places = np.array([_coordinates(pair.vertices).ravel() for pair in pairs], dtype=int).reshape(-1, 12)
        force, blocks = np.zeros(y.size), np.empty((len(pairs), 12, 12))
        for pair, place, block in zip(pairs, places, blocks, strict=True):
            x, x_start = y[pair.vertices].ravel(), y_start[pair.vertices]
            force[place] += self._pair_force(pair, x, x_start, h)
            for k, step in enumerate(_DIFFERENCE_M * np.eye(12)):
                ahead, behind = (self._pair_force(pair, moved, x_start, h) for moved in (x + step, x - step))
                block[:, k] = (ahead - behind) / (2 * _DIFFERENCE_M)
        return self._S.T @ force, self._S.T @ _summed(places, blocks, y.size) @ self._S

    def _vertices(self, X: FloatArray) -> FloatArray:
        return np.asfortranarray((self._S @ X + self._constant).reshape(-1, 3))

    def _active_pairs(self, y: FloatArray) -> list[_Pair]:
        found = ipctk.Candidates()
        found.build(self._mesh, y, self._settings.d_hat_m)
        near = []
        for stencil in [*found.fv_candidates, *found.ee_candidates]:
            vertices = np.array(stencil.vertex_ids(self._mesh.edges, self._mesh.faces))
            if stencil.compute_distance(y[vertices].ravel()) < self._settings.d_hat_m**2:
                near.append(self._pair(stencil, vertices))
        return near

    def _pair(self, stencil: Any, vertices: IndexArray) -> _Pair:
        first, second = sorted(self._body[vertices[[0, 3]]].tolist())
        edges = isinstance(stencil, ipctk.EdgeEdgeCandidate)
        rest = self._mesh.rest_positions[vertices]
        return _Pair(
            stencil=stencil,
            vertices=vertices,
            bodies=(first, second),
            friction=self._friction[first, second],
            mollifier_eps_m4=ipctk.edge_edge_mollifier_threshold(*rest) if edges else None,
        )

    def _pair_force(self, pair: _Pair, x: FloatArray, x_start: FloatArray, h: float) -> FloatArray:
        """Derivative of kappa / h^2 e(c) b(d) by a pair's 12 coordinates, plus friction mu N f1(|u|) against u."""
        kappa, d_hat = self._settings.kappa / h**2, self._settings.d_hat_m
        points, eps = x.reshape(4, 3), pair.mollifier_eps_m4
        d = np.sqrt(pair.stencil.compute_distance(x))
        slope = kappa * ipctk.barrier_first_derivative(d, d_hat)
        force = np.zeros(12)
        if eps is not None and ipctk.edge_edge_cross_squarednorm(*points) < eps:
            slope *= ipctk.edge_edge_mollifier(*points, eps)
            force += kappa * ipctk.barrier(d, d_hat) * ipctk.edge_edge_mollifier_gradient(*points, eps)
        force += slope * pair.stencil.compute_distance_gradient(x) / (2 * d)
        c = pair.stencil.compute_coefficients(x)
        n, slip = c @ points / d, c @ (points - x_start)
        u = slip - (slip @ n) * n
        grip = ipctk.smooth_friction_f1_over_x(np.sqrt(u @ u), self._settings.friction_velocity_m_s * h)
        return np.asarray(force + np.outer(c, pair.friction * -slope * grip * u).ravel())


def _coordinates(nodes: IndexArray) -> IndexArray:
    """Places of the nodes' three coordinates, shape [..., 3]."""
    return 3 * nodes[..., None] + np.arange(3)


def _summed(places: IndexArray, blocks: FloatArray, size: int) -> Matrix:
    """Sparse matrix of 12 x 12 blocks at rows and columns `places` [b, 12]."""
    rows, columns = np.repeat(places, 12, axis=1).ravel(), np.tile(places, 12).ravel()
    return sparse.csr_array(sparse.coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)))
