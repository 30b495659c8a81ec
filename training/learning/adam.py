"""The optimiser of our networks (Kingma and Ba 2015), in NumPy: the same bits on one thread, also when continued."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
Parameters = dict[str, FloatArray]

_FIRST_DECAY, _SECOND_DECAY, _SMALLEST = 0.9, 0.999, 1e-8


class Adam:
    """The state of the optimiser of some parameters.

    Attributes:
        steps: gradient steps made so far.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.steps = 0
        self._parameters = parameters
        self._first = {name: np.zeros_like(value) for name, value in parameters.items()}
        self._second = {name: np.zeros_like(value) for name, value in parameters.items()}

    def descend(self, gradients: Mapping[str, FloatArray], rate: float) -> None:
        """Change the parameters by one gradient step."""
        self.steps += 1
        size = rate * np.sqrt(1.0 - _SECOND_DECAY**self.steps) / (1.0 - _FIRST_DECAY**self.steps)
        for name, gradient in gradients.items():
            first, second = self._first[name], self._second[name]
            first += (1.0 - _FIRST_DECAY) * (gradient - first)
            second += (1.0 - _SECOND_DECAY) * (gradient * gradient - second)
            self._parameters[name] -= (size * first / (np.sqrt(second) + _SMALLEST)).astype(np.float32)

    def state(self) -> dict[str, FloatArray]:
        """Return parameters and state by name, from which learning continues."""
        stored = {f"{group}.{name}": value.copy() for group, values in self._groups() for name, value in values.items()}
        return stored | {"steps": np.array([self.steps], dtype=np.float32)}

    def restore(self, state: Mapping[str, FloatArray]) -> None:
        """Continue from a state."""
        for group, values in self._groups():
            for name in values:
                values[name] = state[f"{group}.{name}"].copy()
        self.steps = int(state["steps"][0])

    def _groups(self) -> tuple[tuple[str, Parameters], ...]:
        return ("p", self._parameters), ("m", self._first), ("v", self._second)
