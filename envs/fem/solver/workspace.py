"""Arrays that solving an IPC step needs, made once per scene."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..contact.stencil import Stencil, new_stencil
from ..elastic.elasticity import new_elastic_batch
from ..linear.elimination import Factor, new_factor
from ..linear.system import SystemLayout
from ..model.newton_system import NewtonSystem, new_newton_system

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class Workspace(NamedTuple):
    """Arrays that `assemble` and the elimination fill."""

    system: NewtonSystem
    factor: Factor
    smallest: FloatArray  # [2] smallest gap [m], smallest det F
    active: IndexArray  # [1] pairs closer than d_hat
    batch: FloatArray  # of tetrahedra at a time, see `elastic.batch`
    stencil: Stencil  # of one contact at a time


def new_workspace(layout: SystemLayout, nodes: int) -> Workspace:
    """Return the arrays for a system of this layout and number of nodes."""
    return Workspace(
        system=new_newton_system(layout, nodes),
        factor=new_factor(layout),
        smallest=np.empty(2),
        active=np.empty(1, dtype=np.int64),
        batch=new_elastic_batch(),
        stencil=new_stencil(),
    )
