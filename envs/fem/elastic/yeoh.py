"""Yeoh's law: what the shear of a hexahedral gel costs beyond a neo-Hookean one.

With e = tr F^T F - 3 and a gel's C10 = mu / 2 the neo-Hookean energy gains

    V (C20 e^2 + C30 e^3)                                                                                            [J]

(Yeoh, *Some forms of the strain energy function for rubber*, Rubber Chemistry and Technology 66 (1993) 754). A gel at
rest has the same moduli with it as without; the stabilisation of hourglasses stays that of the gel at rest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra import Mat3, dot
from ..model.mesh import GelBody
from .neo_hookean import lame_parameters_pa

FloatArray = NDArray[np.float64]


def yeoh_pa(gels: Sequence[GelBody]) -> FloatArray:
    """Return C20 and C30 of all hexahedra of gels [Pa], shape [c, 2]."""
    counts = [len(gel.mesh.hexahedra) for gel in gels]
    rows = []
    for gel in gels:
        mu_pa, _ = lame_parameters_pa(gel.youngs_modulus_pa, gel.poisson_ratio)
        rows.append([0.5 * mu_pa * ratio for ratio in gel.yeoh])
    return np.ascontiguousarray(np.repeat(np.array(rows), counts, axis=0))


@kernel
def yeoh_slopes(F: Mat3, c20_pa: float, c30_pa: float) -> tuple[float, float]:
    """Return the first and second derivative of C20 e^2 + C30 e^3 by e [Pa] at the columns of F.

    As de/dc_k = 2 c_k, the force on column k is 2 V times the first times c_k, and the block of columns k and j is
    2 V times the first times delta_kj I, plus 4 V times the second times c_k c_j^T.
    """
    e = dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2]) - 3.0
    return (2.0 * c20_pa + 3.0 * c30_pa * e) * e, 2.0 * c20_pa + 6.0 * c30_pa * e
