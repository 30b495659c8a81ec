"""The network of the cloned policy, as it learns: mean squared error from the expert's actions, by Adam, in NumPy."""

from collections.abc import Mapping

import numpy as np

from ..learning.adam import Adam, FloatArray
from ..learning.network import TrainingDiverged
from .policy import LAYERS, compute_layers


class Network:
    """Layers, and the state of their optimiser.

    Args:
        sizes: of inputs, hidden layers and outputs.
        random: of the first weights, with the variance of He et al. (2015).

    Attributes:
        parameters: weights and biases by name.
    """

    def __init__(self, sizes: tuple[int, ...], random: np.random.Generator) -> None:
        self.parameters: dict[str, FloatArray] = {}
        for number in range(LAYERS):
            shape = sizes[number : number + 2]
            drawn = random.standard_normal(shape) * np.sqrt(2.0 / shape[0])
            self.parameters[f"weight{number}"] = drawn.astype(np.float32)
            self.parameters[f"bias{number}"] = np.zeros(shape[1], dtype=np.float32)
        self.adam = Adam(self.parameters)

    def learn(self, inputs: FloatArray, actions: FloatArray, *, rate: float, decay: float) -> float:
        """Make one gradient step, let the weights decay (Loshchilov and Hutter 2019), and return the error before.

        Args:
            inputs: shape [n, i].
            actions: of the expert, shape [n, a].
            rate: of learning.
            decay: part of the rate by which weights, not biases, get smaller.

        Raises:
            TrainingDiverged: it is no finite number.
        """
        layers = compute_layers(self.parameters, inputs)
        slope = layers[-1] - actions
        loss = float((slope * slope).mean())
        if not np.isfinite(loss):
            raise TrainingDiverged(f"The loss is {loss} after {self.adam.steps} gradient steps; expected a number.")
        self.adam.descend(compute_gradients(self.parameters, layers, slope * np.float32(2.0 / slope.size)), rate)
        for number in range(LAYERS):
            self.parameters[f"weight{number}"] *= np.float32(1.0 - rate * decay)
        return loss


def compute_gradients(
    parameters: Mapping[str, FloatArray], layers: list[FloatArray], slope: FloatArray
) -> dict[str, FloatArray]:
    """Return the gradients by the chain rule, from the slope of the loss by the outputs."""
    gradients = {}
    for number in reversed(range(LAYERS)):
        gradients[f"weight{number}"] = layers[number].T @ slope
        gradients[f"bias{number}"] = slope.sum(axis=0)
        if number:
            slope = (slope @ parameters[f"weight{number}"].T) * (layers[number] > 0.0)
    return gradients
