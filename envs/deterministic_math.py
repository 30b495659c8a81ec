"""Elementary functions whose bits do not depend on the machine's libm.

Every value that can reach a state or an observation comes from these or from IEEE-754 basic operations
(+, -, *, /, sqrt), which are exactly rounded everywhere. A libm's `log`, `sin` and `cos` are not: their last bit
differs between versions and between the CPU variants that one version picks at run time.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from .compilation import allocating_kernel, kernel

FloatArray = NDArray[np.float64]

_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_SQRT_HALF = 0.7071067811865476
_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_HIGH = 1.5707963267341256
_HALF_PI_LOW = 6.077100506506192e-11
_LARGEST_ANGLE_RAD = 1.0e4
_TWO_PI = 6.283185307179586
_DEG = 57.29577951308232


@kernel
def natural_log(x: float) -> float:
    """Return the natural logarithm, within 1 ulp, of a positive normal number; NaN otherwise.

    x = m 2^k with m in [sqrt(1/2), sqrt(2)); with s = (m - 1)/(m + 1), ln m = 2 artanh(s) = 2 (s + s^3/3 + ...),
    summed to s^23 (|s| <= 0.1716, first neglected term below 2^-57 of the result).
    """
    if not (2.2250738585072014e-308 <= x <= 1.7976931348623157e308):
        return np.nan
    bits: int = _to_bits(x)  # type: ignore[call-arg]
    exponent = ((bits >> 52) & 0x7FF) - 1022
    mantissa = _from_bits((bits & 0x000FFFFFFFFFFFFF) | 0x3FE0000000000000)
    if mantissa < _SQRT_HALF:
        mantissa = 2.0 * mantissa
        exponent -= 1
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    tail = 1.0 / 23.0
    for odd in range(21, 1, -2):
        tail = tail * z + 1.0 / odd
    # 2 artanh(s) = f - s (f - 2 z tail), since 2 s = f - s f: the leading term f is exact.
    return exponent * _LN2_HIGH + (exponent * _LN2_LOW + (f - s * (f - 2.0 * z * tail)))


@kernel
def sine_cosine(angle_rad: float) -> tuple[float, float]:
    """Return the sine and cosine of an angle of at most 1e4 rad, each within 1e-15; NaN beyond.

    Reduced by the nearest multiple of pi/2 (two-part constant), then the Taylor series on [-pi/4, pi/4].
    """
    if not abs(angle_rad) <= _LARGEST_ANGLE_RAD:
        return np.nan, np.nan
    quarter_turns = np.floor(angle_rad * _TWO_OVER_PI + 0.5)
    r = (angle_rad - quarter_turns * _HALF_PI_HIGH) - quarter_turns * _HALF_PI_LOW
    z = r * r
    sine_tail = 0.0
    cosine_tail = 0.0
    for k in range(17, 1, -2):
        sine_tail = (1.0 - sine_tail) * z / (k * (k - 1.0))
        cosine_tail = (1.0 - cosine_tail) * z / (k * (k + 1.0))
    sine = r - r * sine_tail
    cosine = 1.0 - 0.5 * z * (1.0 - cosine_tail)
    quadrant = int(quarter_turns) % 4
    if quadrant == 0:
        return sine, cosine
    if quadrant == 1:
        return cosine, -sine
    if quadrant == 2:
        return -sine, -cosine
    return -cosine, sine


@kernel
def arctangent_deg(y: float, x: float) -> float:
    """Return the angle [deg] from the x axis to the point (x, y), from -180 to 180, to 1e-13.

    Halved twice by tan(a / 2) = t / (1 + sqrt(1 + t^2)), then the series of arctan on |t| <= 0.2.
    """
    t = min(abs(x), abs(y)) / max(abs(x), abs(y))
    for _ in range(2):
        t = t / (1.0 + np.sqrt(1.0 + t * t))
    z = t * t
    tail = 0.0
    for odd in range(25, 0, -2):
        tail = 1.0 / odd - z * tail
    angle = 4.0 * t * tail * _DEG
    if abs(y) > abs(x):
        angle = 90.0 - angle
    if x < 0.0:
        angle = 180.0 - angle
    return angle if y >= 0.0 else -angle


@allocating_kernel
def normal_pairs(uniform: FloatArray) -> FloatArray:
    """Return the independent standard normal numbers from numbers drawn uniformly from [0, 1), both of shape [n, 2].

    Box & Muller, A Note on the Generation of Random Normal Deviates (1958): radius sqrt(-2 ln (1 - p)), angle 2 pi q.
    NumPy's own normal numbers come from libm's logarithm where they lie far out.
    """
    normal = np.empty_like(uniform)
    for i in range(len(uniform)):
        radius = np.sqrt(-2.0 * natural_log(1.0 - uniform[i, 0]))
        sine, cosine = sine_cosine(_TWO_PI * uniform[i, 1])
        normal[i, 0] = radius * cosine
        normal[i, 1] = radius * sine
    return normal


@numba.extending.intrinsic
def _to_bits(typing_context, x):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]  # noqa: ARG001
        return builder.bitcast(arguments[0], context.get_value_type(numba.types.int64))

    return numba.types.int64(numba.types.float64), codegen


@numba.extending.intrinsic
def _from_bits(typing_context, bits):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]  # noqa: ARG001
        return builder.bitcast(arguments[0], context.get_value_type(numba.types.float64))

    return numba.types.float64(numba.types.int64), codegen
