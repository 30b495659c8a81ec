"""The student: value of an action by what was felt so far, distilled from the critic's value of it.

It learns only from histories whose actions no truth has chosen: those of a privileged actor give the offset away by
where the gripper has gone.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat
from vitac.evaluator.strict_model import StrictModel

from ..episodes import Episodes
from ..submission.policy import HISTORY_SIZE, history_features
from .adam import FloatArray
from .critic import stack_states
from .ensemble import Ensemble
from .fitted_value import Count
from .network import Layout, Learner, probability
from .symmetry import HISTORY, TURNABLE


class StudentPlan(StrictModel):
    """How a student is learned, as recipes say it."""

    networks: Count = 2
    """How many, whose mean counts."""
    hidden: Count = 128
    """Units of both layers."""
    epochs: Count = 30
    """Passes over all histories in each round."""
    batch: Count = 128
    """Histories of a gradient step."""
    actions: Count = 16
    """Actions of each history in a gradient step: random ones and some near the critic's best."""
    rate: PositiveFloat = 1.5e-3
    """Learning rate at the start; it falls to a tenth."""
    candidates: Count = 128
    """Actions among which the best is looked for."""


_CHUNK = 2048


ValueOf = Callable[[NDArray[np.int64], FloatArray], FloatArray]
"""Log-odds of success, shape [n, k], of actions, shape [n, k, 3], at histories given by their numbers, shape [n]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Histories:
    """What a student learns from.

    Attributes:
        felt: what a policy knows, shape [n, HISTORY_SIZE].
        states: the critic's of the same moments, shape [n, STATE_SIZE].
        turnable: whether half a turn changes nothing, shape [n].
    """

    felt: FloatArray
    states: FloatArray
    turnable: NDArray[np.bool_]


class Student:
    """Networks that know what a policy knows."""

    def __init__(self, plan: StudentPlan, random: np.random.Generator) -> None:
        self._plan = plan
        layout = Layout(inputs=HISTORY_SIZE, actions=3, hidden=plan.hidden)
        self._ensemble = Ensemble(layout, plan.networks, random)

    def learn(
        self,
        histories: Histories,
        estimate_value: ValueOf,
        random: np.random.Generator,
        after_epoch: Callable[[int, float], None],
    ) -> None:
        """Learn values of actions from histories, starting from what is known.

        Raises:
            TrainingDiverged: a loss is no finite number.
        """
        for epoch in range(self._plan.epochs):
            rate = self._plan.rate * 0.1 ** (epoch / self._plan.epochs)
            losses = [
                self._epoch(learner, histories, estimate_value, random, rate) for learner in self._ensemble.learners
            ]
            after_epoch(epoch, float(np.mean(losses)))

    def best(self, felt: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return the best of some random actions after each history, shape [n, 3]."""
        chosen = np.empty((len(felt), 3), dtype=np.float32)
        for start in range(0, len(felt), _CHUNK):
            rows = slice(start, start + _CHUNK)
            candidates = random.uniform(-1, 1, (self._plan.candidates, 3)).astype(np.float32)
            chosen[rows] = candidates[self._ensemble.mean(felt[rows], candidates).argmax(axis=1)]
        return chosen

    def state(self) -> dict[str, FloatArray]:
        """Return the state that learning continues from."""
        return self._ensemble.state()

    def restore(self, state: Mapping[str, FloatArray]) -> None:
        """Continue from a state."""
        self._ensemble.restore(state)

    def _epoch(
        self, learner: Learner, histories: Histories, estimate_value: ValueOf, random: np.random.Generator, rate: float
    ) -> float:
        losses, order = [], random.permutation(len(histories.felt))
        for start in range(0, len(order), self._plan.batch):
            rows = order[start : start + self._plan.batch]
            actions = self._actions(rows, estimate_value, random)
            targets = probability(estimate_value(rows, actions))
            felt, actions = HISTORY.drawn(histories.felt[rows], actions, histories.turnable[rows], random)
            losses.append(learner.learn(felt, actions, targets, rate=rate))
        return float(np.mean(losses))

    def _actions(self, rows: NDArray[np.int64], estimate_value: ValueOf, random: np.random.Generator) -> FloatArray:
        """Draw the actions whose values are learned: a third of them near the best by these values."""
        near = self._plan.actions // 3
        drawn = random.uniform(-1, 1, (len(rows), self._plan.actions, 3)).astype(np.float32)
        best = drawn[np.arange(len(rows)), estimate_value(rows, drawn).argmax(axis=1)]
        noise = 0.25 * random.standard_normal((len(rows), near, 3)).astype(np.float32)
        drawn[:, :near] = np.clip(best[:, None] + noise, -1, 1)
        return drawn


def make_weights(state: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the networks of a student's state as `submission.policy.values` takes them."""
    named = {tuple(name.split(".")): value for name, value in state.items()}
    return {f"{number}_{name[1]}": value for (number, *name), value in named.items() if name[0] == "p"}


def make_histories(episodes: Episodes) -> Histories:
    """Return what a student learns from episodes: every moment at which an action was chosen."""
    shapes = np.repeat(episodes.shapes, episodes.lengths)
    states = stack_states(episodes.truths[episodes.observations], shapes, episodes.step)
    return Histories(
        felt=student_inputs(episodes)[episodes.observations], states=states, turnable=np.isin(shapes, TURNABLE)
    )


def student_inputs(episodes: Episodes) -> FloatArray:
    """Return what a policy knows at every observation, shape [o, HISTORY_SIZE]."""
    ends, action_ends = np.cumsum(episodes.lengths + 1), np.cumsum(episodes.lengths)
    inputs = [
        history_features(
            episodes.felt[end - length - 1 : end],
            episodes.motions[end - length - 1 : end],
            episodes.actions[action_end - length : action_end],
        )
        for length, end, action_end in zip(episodes.lengths, ends, action_ends, strict=True)
    ]
    return np.concatenate(inputs)
