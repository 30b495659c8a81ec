"""The student, its belief, and the assessor that judges its actions.

The student is the value of an action by what was felt so far, distilled from the critic's value of it. It learns only
from histories whose actions no truth has chosen: those of a privileged actor give the offset away by where the gripper
has gone. Its belief is the offset that follows from its networks' first layers; no action depends on it.

The assessor evaluates the student's policy by temporal differences: the value of the next action is that of the one
which the student would take, by what it would have felt. So what an action tells about the hole has its value, which a
critic that always knows the truth does not see (asymmetric actor-critic: Pinto et al. 2018, Baisero and Amato 2022).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat
from vitac.evaluator.strict_model import StrictModel

from ..episodes import Episodes
from ..submission.policy import HISTORY_SIZE, belief_inputs, history_features
from .critic import STATE_SIZE, Count, Ensemble, FittedValue, FittingPlan, Samples, stack_states, transitions
from .network import HISTORY, STATE, TURNABLE, FloatArray, Layout, Learner, both, probability


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

    def __init__(self, plan: StudentPlan, random: np.random.Generator, *, images: bool = True) -> None:
        self._plan, self._signs = plan, replace(HISTORY, are_drawn=images)
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
            felt, actions = self._signs.drawn(histories.felt[rows], actions, histories.turnable[rows], random)
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


class AssessorPlan(FittingPlan):
    """How an assessor is learned."""

    networks: Count = 2
    hidden: Count = 128
    sweeps: Count = 6
    epochs: Count = 2
    batch: Count = 256
    rate: PositiveFloat = 1e-3
    discount: float = 0.98


@dataclass(frozen=True, kw_only=True, eq=False)
class Assessed:
    """What an assessor learns from: transitions with the student's inputs before and after them.

    Attributes:
        before: inputs before the actions.
        felt: what the student knows after them, shape [n, HISTORY_SIZE].
        after: inputs after them, shape [n, i].
        reached: whether they led to success, shape [n].
        last: whether the episode ended with them, shape [n].
    """

    before: Samples
    felt: FloatArray
    after: FloatArray
    reached: NDArray[np.bool_]
    last: NDArray[np.bool_]


def assessed(episodes: Episodes) -> Assessed:
    """Return what an assessor learns from episodes; whose they are does not matter."""
    known, inputs, rows = transitions(episodes), student_inputs(episodes), episodes.observations
    return Assessed(
        before=Samples(
            inputs=np.concatenate([known.before, inputs[rows]], axis=1), actions=known.actions, turnable=known.turnable
        ),
        felt=inputs[rows + 1],
        after=np.concatenate([known.after, inputs[rows + 1]], axis=1),
        reached=known.reached,
        last=known.last,
    )


class Assessor(FittedValue):
    """Networks that see the truth and what the student knows."""

    def __init__(self, plan: AssessorPlan, random: np.random.Generator, *, images: bool = True) -> None:
        super().__init__(plan, STATE_SIZE + HISTORY_SIZE, replace(both(STATE, HISTORY), are_drawn=images), random)
        self._plan = plan

    def learn(
        self,
        known: Assessed,
        next_actions: FloatArray,
        random: np.random.Generator,
        after_sweep: Callable[[int, float], None],
    ) -> None:
        """Learn the value of a student, starting from what is known.

        Args:
            known: all transitions that there are.
            next_actions: what the student would do after each, shape [n, 3].
            random: of the batches.
            after_sweep: called with the number of each sweep and its mean loss.

        Raises:
            TrainingDiverged: a loss is no finite number.
        """

        def targets() -> FloatArray:
            following = probability(self.log_odds(known.after, next_actions[:, None])[:, 0])
            going_on = np.where(known.last, np.float32(0.0), np.float32(self._plan.discount) * following)
            return np.where(known.reached, np.float32(1.0), going_on)

        self._fit(known.before, targets, random, after_sweep)


OFFSET = slice(0, 3)
"""Where a row of `Episodes.truths` has the offset [mm, mm, deg]."""
_RIDGE = 3e-4
"""Weight of small weights beside the mean square error, for inputs that hardly differ."""


def fit_belief(weights: Mapping[str, FloatArray], episodes: Episodes) -> FloatArray:
    """Return the weights of the belief, shape [inputs, 3].

    Args:
        weights: of the student's networks, as `submission.policy.values` takes them.
        episodes: whose actions no truth has chosen.
    """
    looked = episodes.observations
    inputs = belief_inputs(weights, student_inputs(episodes)[looked]).astype(np.float64)
    offsets = episodes.truths[looked, OFFSET].astype(np.float64)
    squares = inputs.T @ inputs / len(inputs)
    belief = np.linalg.solve(squares + _RIDGE * np.eye(len(squares)), inputs.T @ offsets / len(inputs))
    return np.asarray(belief, dtype=np.float32)
