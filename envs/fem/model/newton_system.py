"""What every term of the energy adds to: the forces and the Newton matrix of one state."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..linear.system import SystemLayout

FloatArray = NDArray[np.float64]
MaskArray = NDArray[np.bool_]

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
