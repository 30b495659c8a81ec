"""The IPC barrier on the plain distance.

    b(d) = -(d - d_hat)^2 ln(d / d_hat)  for 0 < d < d_hat, else 0        [m^2]

Li et al., Incremental Potential Contact (ACM TOG 2020), equations 5-6, here on the distance itself rather than its
square, as the 2025 challenge does. Times kappa / h^2 [N/m] it is an energy.
"""

from ...compilation import kernel
from ...deterministic_math import natural_log


@kernel
def barrier(d: float, d_hat: float) -> tuple[float, float, float]:
    """Return B [m^2], b' [m] (negative) and b'' [-] (positive) at 0 < d < d_hat [m]."""
    gap = d - d_hat
    log_ratio = natural_log(d / d_hat)
    ratio = gap / d
    value = -gap * gap * log_ratio
    first = -gap * (2.0 * log_ratio + ratio)
    second = -2.0 * log_ratio - 4.0 * ratio + ratio * ratio
    return value, first, second
