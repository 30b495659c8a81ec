"""Looks into a scene: its forces, its Newton matrix and its contacts at any state, and a small grasp to look at."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from vitac.envs.fem.contact.broad_phase import Candidates, find_candidates, relative_motion
from vitac.envs.fem.contact.forces import ContactMemory
from vitac.envs.fem.linear.system import GEL_STRIDE, SystemLayout, block_place, gel_block_place, gel_block_places
from vitac.envs.fem.model.model import EXACT_MATRIX, PRESCRIBED, PROJECTED_MATRIX, Model, point_positions
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.fem.solver.assembly import State, StepStart, Workspace, assemble, new_workspace

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Assembled:
    """What the engine assembles at a state.

    Attributes:
        forces_n: dE/dx at the unknown nodes [N], shape [3 u].
        all_forces_n: dE/dx at every node [N], shape [n, 3]; at prescribed nodes what holds them, without inertia.
        sparse_matrix_n_m: Newton matrix [N/m], shape [3 u, 3 u].
        coupling_n: matrix times the prescribed motion, at the unknown nodes [N], shape [3 u].
        active_contacts: pairs closer than d_hat.
    """

    forces_n: FloatArray
    all_forces_n: FloatArray
    sparse_matrix_n_m: csc_array
    coupling_n: FloatArray
    active_contacts: int

    @property
    def matrix_n_m(self) -> FloatArray:
        """The Newton matrix with its zeros [N/m], shape [3 u, 3 u]."""
        return self.sparse_matrix_n_m.toarray()


class Probe:
    """Assembles a scene's model at states of the caller's choice."""

    def __init__(self, scene: Scene, *, start_m: FloatArray | None = None) -> None:
        self.model: Model = scene._model
        self.x_m: FloatArray = scene._x.copy()
        self.start_m = self.x_m.copy() if start_m is None else start_m
        self.x_hat_m = self.start_m.copy()
        self.load_n: FloatArray = scene._weight_n
        self.memory: ContactMemory = scene._memory
        self.unknown_nodes: IndexArray = self.model.unknowns.node
        self.prescribed_nodes: IndexArray = np.flatnonzero(self.model.unknowns.slot == PRESCRIBED)
        self._held_pa: FloatArray = scene._workspace.hexahedron.held_pa  # of viscous branches, in the step at hand
        self._workspace: Workspace = new_workspace(self.model.system, len(self.x_m), len(self._held_pa))

    @cached_property
    def _places(self) -> tuple[IndexArray, IndexArray, IndexArray]:
        return entry_places(self.model.system)

    def points_m(self, x_m: FloatArray) -> FloatArray:
        """Positions of all surface points [m], shape [p, 3]."""
        y = np.empty((len(self.model.points.node_count), 3))
        point_positions(self.model.points, x_m, y)
        return y

    def candidates(self, x_m: FloatArray, reach_m: float) -> Candidates:
        """Candidate pairs within reach."""
        reaches_m = np.full(len(self.model.surfaces.pairs), reach_m)
        return find_candidates(self.model.surfaces, self.points_m(x_m), reaches_m)

    def at(
        self,
        x_m: FloatArray,
        *,
        prescribed_move_m: FloatArray | None = None,
        projected: bool = False,
        listed_at_m: FloatArray | None = None,
    ) -> Assembled:
        """Forces and matrix at node positions [m], shape [n, 3]; contacts may be listed at other positions."""
        move = np.zeros_like(x_m) if prescribed_move_m is None else prescribed_move_m
        listed_m = x_m if listed_at_m is None else listed_at_m
        near = self.candidates(listed_m, self.model.parameters.d_hat_m * 1.5)
        y, y_start = self.points_m(x_m), self.points_m(self.start_m)
        motion = np.empty(len(self.model.surfaces.pairs))
        body_motion = np.empty((len(self.model.surfaces.point_start) - 1, 4))
        relative_motion(self.model.surfaces, y - self.points_m(listed_m), body_motion, motion)
        matrix = PROJECTED_MATRIX if projected else EXACT_MATRIX
        w = self._workspace
        w.system.prescribed_move[:] = move
        w.hexahedron.held_pa[:] = self._held_pa
        start = StepStart(self.x_hat_m, y_start, self.memory, self.load_n.copy())
        # Dual variables of friction are those of the state only where it was not moved to from another one.
        for _ in range(2 if self.model.parameters.remembers_slip else 1):
            assemble(self.model, near, State(x_m, y, motion), start, w, matrix)
        return Assembled(
            forces_n=w.system.gradient[self.unknown_nodes].ravel().copy(),
            all_forces_n=w.system.gradient.copy(),
            sparse_matrix_n_m=_matrix(self._places, w.system.entries),
            coupling_n=w.system.coupling[self.unknown_nodes].ravel().copy(),
            active_contacts=int(w.active[0]),
        )


def dense_matrix(system: SystemLayout, entries: FloatArray) -> FloatArray:
    """The system's matrix from its flat entries, shape [n + m, n + m]."""
    return _matrix(entry_places(system), entries).toarray()


def _matrix(places: tuple[IndexArray, IndexArray, IndexArray], entries: FloatArray) -> csc_array:
    rows, columns, flat = places
    return csc_array((entries[flat], (rows, columns)))


def entry_places(system: SystemLayout) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Row, column and place among the flat entries of every number of the system's matrix that has one."""
    gel, total = system.block.nodes, (system.block.n + system.block.m) // 3
    a = np.concatenate([np.arange(gel), np.repeat(np.arange(gel), np.diff(system.neighbours.start))])
    b = np.concatenate([np.arange(gel), system.neighbours.node])
    framed = [(i, j) for i in range(total) for j in range(total) if max(i, j) >= gel]
    framed_places = [system_place(system, i, j) for i, j in framed]
    framed_a, framed_b = np.array(framed, dtype=np.int64).reshape(-1, 2).T
    first, stride = np.array(framed_places, dtype=np.int64).reshape(-1, 2).T
    rows, columns = np.concatenate([a, framed_a]), np.concatenate([b, framed_b])
    places = np.concatenate([gel_block_places(system.neighbours, a, b), first])
    strides = np.concatenate([np.full(len(a), GEL_STRIDE), stride])
    i, j = np.divmod(np.arange(9), 3)
    return (
        (3 * rows[:, None] + i).ravel(),
        (3 * columns[:, None] + j).ravel(),
        (places[:, None] + strides[:, None] * i + j).ravel(),
    )


def system_place(system: SystemLayout, a: int, b: int) -> tuple[int, int]:
    """Place and row stride of any block; NO_PLACE for gel nodes that are not coupled."""
    if max(a, b) < system.block.nodes:
        return gel_block_place(system.neighbours.start, system.neighbours.node, a, b), GEL_STRIDE
    return block_place(system.block, a, b)
