"""The arrays a scene is made of, laid out for the kernels; built once, never changed while stepping.

*Nodes* are what moves: all mesh nodes of every gel, then four frame points of every affine body. *Unknowns* are the
nodes to solve for: free gel nodes first, in order of elimination, then the frame points of movable bodies (border).
*Points* are the surface points that can touch: a gel's surface nodes and a body's vertices; a point is a weighted sum
of one or four nodes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra import Vec3, load
from ..linear.system import SystemLayout

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
MaskArray = NDArray[np.bool_]

PRESCRIBED = -1
HEXAHEDRON_NODES = 8
# Of a hexahedron: the columns of its deformation gradient and its hourglass vectors, see `elastic.hexahedra`.
MODES = 3 + 4


class Elastic(NamedTuple):
    """Tetrahedra of the gels that are meshed by them alone."""

    nodes: IndexArray  # [t, 4]
    gradients_1_m: FloatArray  # [t, 4, 3] rest gradients of the linear shape functions
    volume_m3: FloatArray  # [t]
    mu_pa: FloatArray  # [t]
    lambda_pa: FloatArray  # [t]
    places: IndexArray  # [t, 16] place of the block of corners (a, b) in the system at 4 a + b, or NO_PLACE
    reaction: MaskArray  # [t, 16] whether exactly one of the two corners is prescribed


class Hexahedra(NamedTuple):
    """Hexahedra of the gels that are meshed by them, see `elastic.hexahedra`."""

    nodes: IndexArray  # [c, 8]
    weights: FloatArray  # of node a in mode t of hexahedron h at 8 (7 h + t) + a; columns of F [1/m], then hourglasses
    volume_m3: FloatArray  # [c]
    mu_pa: FloatArray  # [c]
    lambda_pa: FloatArray  # [c]
    stabilisation_n_m: FloatArray  # [c, 18]
    viscous_pa: FloatArray  # [c] modulus of all viscous branches in a step, see `elastic.viscosity`; 0 for none
    yeoh_pa: FloatArray  # [c, 2] C20 and C30, see `elastic.yeoh`; 0 for none
    places: IndexArray  # [c, 64] place of the block of nodes (a, b) in the system at 8 a + b, or NO_PLACE


class Affine(NamedTuple):
    """Movable affine bodies."""

    first_node: IndexArray  # [m] first of the four frame points
    first_unknown: IndexArray  # [m] its unknown
    frame_length_m: FloatArray  # [m]
    mass_kg: FloatArray  # [m, 4, 4]
    stiffness_j: FloatArray  # [m] factor of |A A^T - I|^2, proportional to the volume


class Points(NamedTuple):
    """Surface points of all bodies."""

    nodes: IndexArray  # [p, 4]; only the first is used where count is 1
    weights: FloatArray  # [p, 4]
    node_count: IndexArray  # [p] 1 (gel) or 4 (affine body)


class Surfaces(NamedTuple):
    """Collision primitives, in point indices, grouped by body: body b owns rows start[b] to start[b + 1]."""

    point_start: IndexArray  # [b + 1]
    edges: IndexArray  # [e, 2]
    edge_start: IndexArray  # [b + 1]
    edge_squared_length_m2: FloatArray  # [e] at rest
    triangles: IndexArray  # [f, 3]
    triangle_start: IndexArray  # [b + 1]
    vertices: IndexArray  # [v] points that are paired with triangles
    vertex_start: IndexArray  # [b + 1]
    neighbours: IndexArray  # [f, 3] triangle beyond the edge from corner i to corner i + 1
    around: IndexArray  # triangles around each point, ascending
    around_start: IndexArray  # [p + 1]
    point_body: IndexArray  # [p] body that a point belongs to
    pairs: IndexArray  # [k, 2] bodies that can touch, smaller index first
    pair_friction: FloatArray  # [k] friction coefficient


class Unknowns(NamedTuple):
    """Numbering of what is solved for."""

    slot: IndexArray  # [n] unknown of a node, or PRESCRIBED
    node: IndexArray  # [u] node of an unknown
    node_mass_kg: FloatArray  # [n] lumped, zero for frame points


class Parameters(NamedTuple):
    """Scalars of contact and time stepping."""

    time_step_s: float
    d_hat_m: float
    barrier_stiffness_n_m: float
    counts_once: bool  # whether a place of a surface counts once, see `contact.features`, or with each pair
    remembers_slip: bool  # whether contacts carry their elastic slip over to the next step, see `contact.forces`
    slip_scale_m: float  # slip at which friction is fully developed, where contacts remember nothing
    tangential_stiffness_n_m: float  # of a contact that sticks, where contacts remember
    ccd_gap_fraction: float  # part of a gap that one move may close
    candidate_margin_m: float


class Model(NamedTuple):
    """Everything constant about a scene."""

    elastic: Elastic
    hexahedra: Hexahedra
    affine: Affine
    points: Points
    surfaces: Surfaces
    unknowns: Unknowns
    system: SystemLayout
    parameters: Parameters


# Which matrix goes with the forces: none, the exact Jacobian, or its positive semi-definite replacement.
NO_MATRIX = 0
EXACT_MATRIX = 1
PROJECTED_MATRIX = 2


class NewtonSystem(NamedTuple):
    """Forces, matrix and right-hand side, with the motion of the prescribed nodes that these are for."""

    gradient: FloatArray  # [n, 3] dE/dx [N], prescribed nodes included
    entries: FloatArray  # the matrix, see `linear.system`
    coupling: FloatArray  # [n, 3] Jacobian times the prescribed motion [N]
    right_hand_side: FloatArray  # [3 u] [N]
    prescribed_move: FloatArray  # [n, 3] motion left for the prescribed nodes [m], zero for others
    moves: MaskArray  # [1] whether any of it is left, so that there is a coupling


def new_newton_system(layout: SystemLayout, nodes: int) -> NewtonSystem:
    """Return the arrays for a system of this layout and number of nodes; no prescribed motion."""
    return NewtonSystem(
        gradient=np.empty((nodes, 3)),
        entries=np.empty(layout.size),
        coupling=np.empty((nodes, 3)),
        right_hand_side=np.empty(layout.block.n + layout.block.m),
        prescribed_move=np.zeros((nodes, 3)),
        moves=np.empty(1, dtype=np.bool_),
    )


@kernel
def weight_place(h: int, mode: int, a: int) -> int:
    """Return where the weight of node a in a mode of hexahedron h stands in `Hexahedra.weights`."""
    return HEXAHEDRON_NODES * (MODES * h + mode) + a


@kernel
def get_mode(hexahedra: Hexahedra, h: int, mode: int, x: FloatArray) -> Vec3:
    """Return a mode of hexahedron h of nodes (or moves of nodes) x [n, 3]; the first three are the columns of F."""
    total = (0.0, 0.0, 0.0)
    for a in range(HEXAHEDRON_NODES):
        w, p = hexahedra.weights[weight_place(h, mode, a)], load(x, hexahedra.nodes[h, a])
        total = total[0] + w * p[0], total[1] + w * p[1], total[2] + w * p[2]
    return total


@kernel
def point_positions(points: Points, x: FloatArray, y: FloatArray) -> None:
    """Write positions (or displacements) of all surface points, y [p, 3], from those of the nodes, x [n, 3]."""
    nodes, weights, count = points.nodes, points.weights, points.node_count
    for p in range(len(count)):
        if count[p] == 1:
            for k in range(3):
                y[p, k] = x[nodes[p, 0], k]
        else:
            for k in range(3):
                y[p, k] = (
                    weights[p, 0] * x[nodes[p, 0], k]
                    + weights[p, 1] * x[nodes[p, 1], k]
                    + weights[p, 2] * x[nodes[p, 2], k]
                    + weights[p, 3] * x[nodes[p, 3], k]
                )
