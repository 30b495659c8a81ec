"""What every term of the energy adds to: the forces and the Newton system of one state."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..contact.stencil import Stencil, new_stencil
from ..elastic.batch import new_batch
from ..linear.elimination import Factor, new_factor
from ..linear.system import SystemLayout

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
MaskArray = NDArray[np.bool_]

# Which matrix goes with the forces: none, the exact Jacobian, or its positive semi-definite replacement.
NO_MATRIX = 0
EXACT_MATRIX = 1
PROJECTED_MATRIX = 2


class Workspace(NamedTuple):
    """Arrays that `assemble` fills, term by term."""

    entries: FloatArray  # the matrix, see `linear_system`
    right_hand_side: FloatArray  # [3 u] [N]
    factor: Factor
    gradient: FloatArray  # [n, 3] dE/dx [N], prescribed nodes included
    coupling: FloatArray  # [n, 3] Jacobian times the prescribed motion [N]
    moves: MaskArray  # [1] whether prescribed nodes move, so that there is a coupling
    smallest: FloatArray  # [2] smallest gap [m], smallest det F
    active: IndexArray  # [1] pairs closer than d_hat
    batch: FloatArray  # of tetrahedra at a time, see `batch`
    stencil: Stencil  # of one contact at a time


def new_workspace(layout: SystemLayout, nodes: int) -> Workspace:
    """Uninitialised arrays for a system of this layout and so many nodes."""
    return Workspace(
        entries=np.empty(layout.size),
        right_hand_side=np.empty(layout.block.n + layout.block.m),
        factor=new_factor(layout),
        gradient=np.empty((nodes, 3)),
        coupling=np.empty((nodes, 3)),
        moves=np.empty(1, dtype=np.bool_),
        smallest=np.empty(2),
        active=np.empty(1, dtype=np.int64),
        batch=new_batch(),
        stencil=new_stencil(),
    )
