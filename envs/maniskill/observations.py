"""Observations of ManiSkill as plain arrays: without the batch dimension, one key for each leaf."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def flattened(observation: Mapping[str, Any], prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the leaves of a nested observation by their path, joined by `_`, in their order.

    `sensor_data` and `sensor_param` are left out of the path: the camera's name follows.
    """
    leaves: dict[str, NDArray[Any]] = {}
    for key, value in observation.items():
        path = prefix if key in {"sensor_data", "sensor_param"} else f"{prefix}{key}_"
        if isinstance(value, Mapping):
            leaves |= flattened(value, path)
        else:
            leaves[path.removesuffix("_")] = unbatched(value)
    return leaves


def unbatched(value: Any) -> NDArray[Any]:
    """Return a tensor or array of one environment without its batch dimension, in memory of its own."""
    array = np.array(value.cpu().numpy() if hasattr(value, "cpu") else value)
    first = array[0] if array.ndim else array
    return np.ascontiguousarray(first.astype(np.uint8) if first.dtype == np.bool_ else first)


def parts_of_state(observation: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Return names and sizes of the parts of the `state` vector, from the same observation as a dictionary."""
    return [(name, int(value.size)) for name, value in flattened(observation).items()]
