"""Small networks Q(input, action) in NumPy, their optimiser, and the mirror images that they also learn from.

Two hidden layers, trained by Adam (Kingma and Ba 2015) on the cross-entropy of a probability. Everything is float32 on
one thread in a fixed order, so that a continued run has the bits of an uninterrupted one. Every peg with its hole is
the same in the mirror with normal x; cuboid and bow tie are the same after half a turn too.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..submission.policy import MAX_STEPS

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
        first, second, predicted = _forward(self.parameters, inputs, actions)
        loss = float((np.maximum(predicted, 0.0) - predicted * targets + np.log1p(np.exp(-np.abs(predicted)))).mean())
        if not np.isfinite(loss):
            steps = self.adam.steps
            raise TrainingDiverged(f"The loss is {loss} after {steps} gradient steps; expected a finite number.")
        slope = ((probability(predicted) - targets) / np.float32(predicted.size))[..., None]
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


TURNABLE = (0, 2)
"""Numbers of the shapes that look the same after half a turn: cuboid and bow tie."""
_MIRROR_ACTION = np.array([-1, 1, -1], dtype=np.float32)
_TURN_ACTION = np.array([-1, -1, 1], dtype=np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Signs:
    """Signs by which the numbers of an input are multiplied.

    Attributes:
        mirror: in a mirror with normal x, shape [i].
        turn: after half a turn about z, shape [i].
        are_drawn: whether mirror images and half turns of what was played could have been played, too.
    """

    mirror: FloatArray
    turn: FloatArray
    are_drawn: bool = True

    def changed(
        self, inputs: FloatArray, actions: FloatArray, flips: NDArray[np.bool_], turns: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """Return inputs, shape [n, i], and actions, shape [n, 3] or [n, k, 3], the chosen ones mirrored or turned."""
        inputs = np.where(flips[:, None], inputs * self.mirror, inputs)
        inputs = np.where(turns[:, None], inputs * self.turn, inputs)
        rows = flips.reshape(-1, *[1] * (actions.ndim - 1)), turns.reshape(-1, *[1] * (actions.ndim - 1))
        actions = np.where(rows[0], actions * _MIRROR_ACTION, actions)
        return inputs, np.where(rows[1], actions * _TURN_ACTION, actions)

    def drawn(
        self, inputs: FloatArray, actions: FloatArray, turnable: NDArray[np.bool_], random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return inputs and actions, each half of the times mirrored, and turned where half a turn changes nothing."""
        if not self.are_drawn:
            return inputs, actions
        flips, turns = random.integers(2, size=(2, len(inputs))) == 1
        return self.changed(inputs, actions, flips, turns & turnable)


def both(first: Signs, second: Signs) -> Signs:
    """Return the signs of two inputs side by side."""
    return Signs(mirror=np.concatenate([first.mirror, second.mirror]), turn=np.concatenate([first.turn, second.turn]))


def _signs(mirror: list[int], turn: list[int]) -> Signs:
    return Signs(mirror=np.array(mirror, dtype=np.float32), turn=np.array(turn, dtype=np.float32))


# x, y, theta; x, y in the gripper's axes; how far the peg is from its command: x, y, z, roll, pitch, yaw; env step;
# shape, one of three
STATE = _signs(
    [-1, 1, -1, -1, 1, -1, 1, 1, 1, -1, -1, 1, 1, 1, 1], [-1, -1, 1, -1, -1, -1, -1, 1, -1, -1, 1, 1, 1, 1, 1]
)
# shift x, y, z and turn about x, y, z that were felt; the gripper's x, y, theta; whether theta is known
_MOMENT = _signs([-1, 1, 1, 1, -1, -1, -1, 1, -1, 1], [-1, -1, 1, -1, -1, 1, -1, -1, 1, 1])
_STEPS = _signs([1] * MAX_STEPS, [1] * MAX_STEPS)
HISTORY = both(Signs(mirror=np.tile(_MOMENT.mirror, MAX_STEPS + 1), turn=np.tile(_MOMENT.turn, MAX_STEPS + 1)), _STEPS)
