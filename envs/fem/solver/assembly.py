"""Sums forces and matrix of all terms, inertia among them, into the arrays of a scene."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..affine import add_orthogonality
from ..algebra import add_rows, add_to_row, any_nonzero, load, scale, subtract
from ..contact.assembly import PointState, add_contacts
from ..contact.broad_phase import Candidates
from ..contact.forces import ContactMemory
from ..contact.stencil import Stencil, new_stencil
from ..elastic.elasticity import add_elasticity, new_elastic_batch
from ..elastic.hexahedra import HexahedronScratch, add_hexahedra, new_hexahedron_scratch
from ..linear.elimination import Factor, new_factor
from ..linear.system import SystemLayout, block_place
from ..model.model import NO_MATRIX, Model, NewtonSystem, new_newton_system

FloatArray = NDArray[np.float64]


@kernel
def add_inertia(model: Model, x: FloatArray, x_hat: FloatArray, system: NewtonSystem, matrix: int) -> None:
    """Add the force m (x - x_hat) / h^2 [N] and the matrix m / h^2 [N/m] of free nodes and movable bodies."""
    inverse_h2 = 1.0 / (model.parameters.time_step_s * model.parameters.time_step_s)
    gradient, entries, layout = system.gradient, system.entries, model.system.block
    unknown_nodes, masses = model.unknowns.node, model.unknowns.node_mass_kg
    for u in range(layout.nodes):
        node = unknown_nodes[u]
        m = masses[node] * inverse_h2
        add_to_row(gradient, node, scale(m, subtract(load(x, node), load(x_hat, node))))
        if matrix != NO_MATRIX:
            place, stride = block_place(layout, u, u)
            _add_multiple_of_identity(entries, place, stride, m)
    affine = model.affine
    for i in range(len(affine.first_node)):
        node, unknown = affine.first_node[i], affine.first_unknown[i]
        for k in range(4):
            for j in range(4):
                m = affine.mass_kg[i, k, j] * inverse_h2
                offset = subtract(load(x, node + j), load(x_hat, node + j))
                add_to_row(gradient, node + k, scale(m, offset))
                if matrix != NO_MATRIX:
                    place, stride = block_place(layout, unknown + k, unknown + j)
                    _add_multiple_of_identity(entries, place, stride, m)


@kernel
def _add_multiple_of_identity(entries: FloatArray, place: int, stride: int, m: float) -> None:
    for k in range(3):
        entries[place + k * (stride + 1)] += m


IndexArray = NDArray[np.int64]


class Workspace(NamedTuple):
    """Arrays that `assemble` and the elimination fill."""

    system: NewtonSystem
    factor: Factor
    smallest: FloatArray  # [2] smallest gap [m], smallest det F
    active: IndexArray  # [1] pairs closer than d_hat
    batch: FloatArray  # of tetrahedra at a time, see `elastic.batch`
    hexahedron: HexahedronScratch  # of one at a time
    stencil: Stencil  # of one contact at a time


def new_workspace(layout: SystemLayout, nodes: int, viscous: int = 0) -> Workspace:
    """Return the arrays for a system of this layout, number of nodes, and of hexahedra with viscosity."""
    return Workspace(
        system=new_newton_system(layout, nodes),
        factor=new_factor(layout),
        smallest=np.empty(2),
        active=np.empty(1, dtype=np.int64),
        batch=new_elastic_batch(),
        hexahedron=new_hexahedron_scratch(viscous),
        stencil=new_stencil(),
    )


class State(NamedTuple):
    """Where the scene is."""

    x: FloatArray  # [n, 3] nodes [m]
    y: FloatArray  # [p, 3] their surface points [m]
    motion: FloatArray  # [k] largest motion of each pair of bodies since the candidates were listed [m]


class StepStart(NamedTuple):
    """From where inertia and friction of an IPC step are measured."""

    x_hat: FloatArray  # [n, 3] nodes at the end of the step without forces [m]
    y_start: FloatArray  # [p, 3] points at its start [m]
    memory: ContactMemory  # of contacts at its start
    held: FloatArray  # [n, 3] forces that are taken away from those of the potential [N]


@large_kernel
def assemble(
    model: Model, candidates: Candidates, state: State, start: StepStart, workspace: Workspace, matrix: int
) -> None:
    """Write the forces, and the system with the matrix asked for, at a state.

    The right-hand side also carries the system's prescribed motion, moved to the known side.
    """
    system = workspace.system
    system.gradient[:] = 0.0
    if matrix != NO_MATRIX:
        system.entries[:] = 0.0
        system.coupling[:] = 0.0
        system.moves[0] = any_nonzero(system.prescribed_move)
    workspace.smallest[1] = min(
        add_elasticity(model.elastic, state.x, workspace.batch, system, matrix),
        add_hexahedra(model.hexahedra, state.x, workspace.hexahedron, system, matrix),
    )
    add_inertia(model, state.x, start.x_hat, system, matrix)
    add_orthogonality(model.affine, model.system.block, state.x, system, matrix)
    points = PointState(state.y, start.y_start, state.motion, start.memory)
    gap, active = add_contacts(model, candidates, points, workspace.stencil, system, matrix)
    workspace.smallest[0], workspace.active[0] = gap, active
    add_rows(system.gradient, -1.0, start.held, system.gradient)
    if matrix != NO_MATRIX:
        _write_right_hand_side(model, system)


@kernel
def _write_right_hand_side(model: Model, system: NewtonSystem) -> None:
    gradient, coupling = system.gradient, system.coupling
    for u in range(len(model.unknowns.node)):
        node = model.unknowns.node[u]
        for k in range(3):
            system.right_hand_side[3 * u + k] = -gradient[node, k] - coupling[node, k]
