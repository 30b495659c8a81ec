"""The network of a cloned policy and the episodes that it learns from.

Each env step of an episode has the action that the expert would take; the network learns by mean squared error, or
quantiles where nothing can be taken back, by Adam, in NumPy.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.tracks import Task

from ..demonstrations.expert import Expert, ExpertPlan
from ..learning.network import Adam, TrainingDiverged
from .policy import LAYERS, FloatArray, Memory, choose_action, compute_layers

EXACTLY = ExpertPlan(gain=1.0, measured=False)
BOLDLY = replace(EXACTLY, gain=1.5)
"""How the expert goes to the target, from where the part is measured to be."""
SPREAD = 0.6
"""Largest standard deviation of the noise on the expert's actions; each of its episodes draws its own.

That of an exact expert is the cube of the part that is drawn, so half of its episodes have less than an eighth: more
undoes a grip, or what is put in.
"""
NEAR = np.array([1.0, 1.0, 1.5])
"""Offset [mm, mm, degree] within which the expert lowers a peg: a policy that cannot see it never gets to none."""
CAUTION = 0.25
"""Part of the expert's actions at what is felt that are smaller than what a cautious policy does."""
ROUNDING = 0.03
"""Errors of actions below which the loss of quantiles is rounded off."""
Loss = Callable[[FloatArray, FloatArray], tuple[float, FloatArray]]
"""Returns the mean loss, and its slopes, of the outputs for the expert's actions; shapes [n, a]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClonedEpisodes:
    """Episodes one after the other.

    Attributes:
        rows: what a policy remembers of each observation before an action, shape [n, r].
        actions: the expert's there, shape [n, a].
        lengths: env steps of each episode, shape [e].
        solved: whether each ended with success, shape [e].
        shapes: of the parts, shape [e].
    """

    rows: FloatArray
    actions: FloatArray
    lengths: NDArray[np.int64]
    solved: NDArray[np.bool_]
    shapes: NDArray[np.str_]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def join(parts: Sequence[ClonedEpisodes]) -> ClonedEpisodes:
    """Return episodes one after the other; there must be some."""
    arrays = [part.arrays() for part in parts]
    return ClonedEpisodes(**{name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]})


class ClonedTask:
    """A task with its environment and its expert.

    Args:
        task: that is played.
        keys: what a policy observes.
        sensor: design of both sensors, where the task has one.

    Attributes:
        env: the environment.
        n_actions: numbers of an action.
        loss: by which a network learns from the expert.

    Raises:
        NoExpert: the task says no way to its target.
    """

    def __init__(self, task: Task, keys: Sequence[str], sensor: Any = None) -> None:
        self._expert = Expert(task, keys, **({} if sensor is None else {"sensor": sensor}))
        self.env = self._expert.env
        self.n_actions = len(task.actions)
        self._plan, self._spread_power = (EXACTLY, 3) if task.definition.guides_exactly else (BOLDLY, 1)
        self.loss: Loss = squared if task.definition.can_go_back else cautious

    def play(self, seed: int, numbers: Sequence[int], weights: Mapping[str, FloatArray] | None) -> ClonedEpisodes:
        """Play episodes of a stream by the weights of a policy, or by the expert with noise where there are none."""
        return join([self._play_one((seed, number), weights) for number in numbers])

    def _play_one(self, start: tuple[int, int], weights: Mapping[str, FloatArray] | None) -> ClonedEpisodes:
        random = np.random.default_rng((*start, 1))
        spread = SPREAD * random.uniform() ** self._spread_power
        observation, info = self.env.reset(options={"rng_seed": start})
        memory, actions = Memory(self.n_actions), []
        while info["end_reason"] is None:
            memory.observe(observation)
            actions.append(self.expert_action(info, random))
            if weights is None:
                noisy = actions[-1] + spread * random.standard_normal(self.n_actions)
                memory.last_action = np.asarray(np.clip(noisy, -1.0, 1.0), dtype=np.float32)
            else:
                memory.last_action = choose_action(weights, np.array(memory.rows))
            observation, _, _, _, info = self.env.step(memory.last_action)
        return ClonedEpisodes(
            rows=np.array(memory.rows),
            actions=np.array(actions),
            lengths=np.array([len(actions)]),
            solved=np.array([bool(info["is_success"])]),
            shapes=np.array([str(self.env.task_scene.shape)]),
        )

    def expert_action(self, info: Mapping[str, Any], random: np.random.Generator) -> FloatArray:
        """Return what the expert would do."""
        info = self._expert.measure(info)
        offset = info.get("gt_offset_mm_deg", ())
        if len(offset) > len(NEAR) and (np.abs(offset[: len(NEAR)]) < NEAR).all():
            info = {**info, "gt_offset_mm_deg": np.array([0.0, 0.0, 0.0, *offset[len(NEAR) :]])}
        return self._expert.act(self._plan, info, random)


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

    def learn(self, inputs: FloatArray, actions: FloatArray, *, rate: float, decay: float, loss: Loss) -> float:
        """Make one gradient step, let the weights decay (Loshchilov and Hutter 2019), and return the loss before.

        Args:
            inputs: shape [n, i].
            actions: of the expert, shape [n, a].
            rate: of learning.
            decay: part of the rate by which weights, not biases, get smaller.
            loss: of the outputs.

        Raises:
            TrainingDiverged: it is no finite number.
        """
        layers = compute_layers(self.parameters, inputs)
        mean, slopes = loss(layers[-1], actions)
        if not np.isfinite(mean):
            raise TrainingDiverged(f"The loss is {mean} after {self.adam.steps} gradient steps; expected a number.")
        self.adam.descend(compute_gradients(self.parameters, layers, slopes), rate)
        for number in range(LAYERS):
            self.parameters[f"weight{number}"] *= np.float32(1.0 - rate * decay)
        return mean


def squared(outputs: FloatArray, actions: FloatArray) -> tuple[float, FloatArray]:
    """Return the mean squared error, by which outputs become the mean of the expert's actions; a `Loss`."""
    errors = outputs - actions
    return float((errors * errors).mean()), errors * np.float32(2.0 / errors.size)


def cautious(outputs: FloatArray, actions: FloatArray) -> tuple[float, FloatArray]:
    """Return the loss by which the size of an output becomes a low quantile of the expert's actions; a `Loss`.

    The quantile loss of Koenker and Bassett (1978), rounded off. One that goes further than the expert costs more.
    """
    errors = outputs - actions
    sizes = np.abs(errors)
    is_too_far = (errors > 0.0) == (outputs > 0.0)
    weights = np.where(is_too_far, np.float32(1.0 - CAUTION), np.float32(CAUTION))
    losses = np.where(sizes < ROUNDING, 0.5 * sizes * sizes / ROUNDING, sizes - 0.5 * ROUNDING)
    slopes = weights * np.clip(errors / np.float32(ROUNDING), -1.0, 1.0) / np.float32(errors.size)
    return float((weights * losses).mean()), slopes


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
