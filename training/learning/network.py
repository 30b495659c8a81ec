"""Small networks Q(input, action) in NumPy: two hidden layers, trained by Adam on the cross-entropy of a probability.

Everything is float32 on one thread in a fixed order, so that a continued run has the bits of an uninterrupted one.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from vitac.envs.errors import VitacError

from .adam import Adam, FloatArray, Parameters


class TrainingDiverged(VitacError):
    """A network's loss is no finite number any more; the last good state is kept. Lower the learning rate."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Sizes of a network.

    Attributes:
        inputs: numbers beside the action.
        actions: numbers of an action.
        hidden: units of both hidden layers.
    """

    inputs: int
    actions: int
    hidden: int


def new_parameters(layout: Layout, random: np.random.Generator) -> Parameters:
    """Return weights drawn with the variance of He et al. (2015), and biases of zero."""

    def drawn(rows: int, columns: int, fan_in: int) -> FloatArray:
        return np.asarray(random.standard_normal((rows, columns)) * np.sqrt(2.0 / fan_in), dtype=np.float32)

    fan_in = layout.inputs + layout.actions
    return {
        "history": drawn(layout.inputs, layout.hidden, fan_in),
        "action": drawn(layout.actions, layout.hidden, fan_in),
        "bias0": np.zeros(layout.hidden, dtype=np.float32),
        "weight1": drawn(layout.hidden, layout.hidden, layout.hidden),
        "bias1": np.zeros(layout.hidden, dtype=np.float32),
        "weight2": 0.1 * drawn(layout.hidden, 1, layout.hidden),
        "bias2": np.zeros(1, dtype=np.float32),
    }


def logits(parameters: Mapping[str, FloatArray], inputs: FloatArray, actions: FloatArray) -> FloatArray:
    """Return the log-odds of success of several actions for each input.

    Args:
        parameters: of the network.
        inputs: shape [n, i].
        actions: shape [n, k, a], or [k, a] for the same actions at every input.

    Returns:
        Shape [n, k].
    """
    return _forward(parameters, inputs, actions)[2]


def probability(log_odds: FloatArray) -> FloatArray:
    """Return the logistic function, without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * log_odds)), dtype=np.float32)


def _forward(
    parameters: Mapping[str, FloatArray], inputs: FloatArray, actions: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    p = parameters
    first: FloatArray = (inputs @ p["history"])[:, None, :] + actions @ p["action"] + p["bias0"]
    np.maximum(first, 0.0, out=first)
    second: FloatArray = first @ p["weight1"] + p["bias1"]
    np.maximum(second, 0.0, out=second)
    return first, second, np.asarray((second @ p["weight2"] + p["bias2"])[..., 0])


class Learner:
    """A network and the state of its optimiser (Kingma and Ba 2015).

    Attributes:
        parameters: of the network.
        adam: optimiser, with the state that learning continues from.
    """

    def __init__(self, layout: Layout, random: np.random.Generator) -> None:
        self.parameters = new_parameters(layout, random)
        self.adam = Adam(self.parameters)

    def learn(self, inputs: FloatArray, actions: FloatArray, targets: FloatArray, *, rate: float) -> float:
        """Make one gradient step and return the mean cross-entropy before it.

        Args:
            inputs: shape [n, i].
            actions: shape [n, k, a].
            targets: probabilities, shape [n, k].
            rate: of learning.

        Raises:
            TrainingDiverged: the loss is not finite; nothing has been changed.
        """
        first, second, found = _forward(self.parameters, inputs, actions)
        loss = float((np.maximum(found, 0.0) - found * targets + np.log1p(np.exp(-np.abs(found)))).mean())
        if not np.isfinite(loss):
            steps = self.adam.steps
            raise TrainingDiverged(f"The loss is {loss} after {steps} gradient steps; expected a finite number.")
        slope = ((probability(found) - targets) / np.float32(found.size))[..., None]
        self.adam.descend(_gradients(self.parameters, (inputs, actions, first, second), slope), rate)
        return loss


def _gradients(
    parameters: Parameters, seen: tuple[FloatArray, FloatArray, FloatArray, FloatArray], slope: FloatArray
) -> Parameters:
    """Return the gradients by the chain rule; `slope` is that of the loss by the log-odds, shape [n, k, 1]."""
    inputs, actions, first, second = seen
    rows = -1, first.shape[-1]
    into_second = (slope @ parameters["weight2"].T) * (second > 0.0)
    into_first = (into_second @ parameters["weight1"].T) * (first > 0.0)
    flat_second, flat_first = into_second.reshape(rows), into_first.reshape(rows)
    return {
        "history": inputs.T @ into_first.sum(axis=1),
        "action": actions.reshape(-1, actions.shape[-1]).T @ flat_first,
        "bias0": flat_first.sum(axis=0),
        "weight1": first.reshape(rows).T @ flat_second,
        "bias1": flat_second.sum(axis=0),
        "weight2": second.reshape(rows).T @ slope.reshape(-1, 1),
        "bias2": slope.reshape(-1, 1).sum(axis=0),
    }
