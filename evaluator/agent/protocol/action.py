"""What counts as an action, and as a belief: checked outside the sandbox, on the arrays of an answer."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..verdicts import PolicyFailed, VerdictCode
from .frames import Array

ACTION_TYPES: Final = (
    "An action is a NumPy array, list, tuple or torch tensor (on the CPU, without gradient) of integers or "
    "floating-point numbers, which are converted to float32; truth values, complex numbers, text and objects fail the "
    "episode."
)
"""What `act` may return, as documents and the rules page say it."""


def checked_action(arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the action as float32 of the given shape, finite; it is not clipped here.

    Raises:
        PolicyFailed: protocol_violation, bad_action_type, bad_action_shape, non_finite_action.
    """
    return _checked("action", arrays, shape)


def checked_belief(arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """Return what a policy believes as float32 of the given shape, finite; None where it says nothing.

    Raises:
        PolicyFailed: as for an action.
    """
    return _checked("belief", arrays, shape) if arrays else None


def _checked(name: str, arrays: Mapping[str, Array], shape: tuple[int, ...]) -> NDArray[np.float32]:
    if set(arrays) != {name}:
        raise PolicyFailed(
            VerdictCode.PROTOCOL_VIOLATION, f"An answer held the arrays {sorted(arrays)}, expected '{name}' alone."
        )
    numbers, title = arrays[name], name.capitalize()
    if numbers.dtype.kind not in "fiu":
        raise PolicyFailed(
            VerdictCode.BAD_ACTION_TYPE,
            f"{title} has dtype {numbers.dtype}, expected real numbers.",
        )
    if numbers.shape != shape:
        raise PolicyFailed(VerdictCode.BAD_ACTION_SHAPE, f"{title} has shape {numbers.shape}, expected {shape}.")
    with np.errstate(over="ignore", invalid="ignore"):
        converted = numbers.astype(np.float32)
    if not np.isfinite(converted).all():
        raise PolicyFailed(
            VerdictCode.NON_FINITE_ACTION,
            f"{title} is {numbers.tolist()}, expected finite numbers in the range of float32.",
        )
    return converted
