"""The student: value of an action by what was felt so far, distilled from the critic's value of it.

It learns only from histories whose actions no truth has chosen: those of a privileged actor give the offset away by
where the gripper has gone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .critic import MIRROR_ACTION, Critic, states_of
from .episodes import Episodes
from .network import FloatArray, Layout, Learner, probability
from .submission.policy import FIELD_SIZE, GRID_U_PX, GRID_V_PX, HISTORY_SIZE, MOST_STEPS, history_features


@dataclass(frozen=True, kw_only=True)
class StudentPlan:
    """How a student is learned.

    Attributes:
        networks: whose mean counts.
        hidden: units of both layers.
        epochs: over all histories.
        batch: histories of a gradient step.
        actions: of each history in a gradient step, random ones and some near the critic's best.
        rate: of learning at the start; it falls to a tenth.
    """

    networks: int = 2
    hidden: int = 128
    epochs: int = 30
    batch: int = 128
    actions: int = 16
    rate: float = 1.5e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Histories:
    """What a student learns from: histories of shape [n, HISTORY_SIZE] and the critic's states of the same moments."""

    felt: FloatArray
    states: FloatArray


class Student:
    """Networks that know what a policy knows."""

    def __init__(self, plan: StudentPlan, random: np.random.Generator) -> None:
        self._plan = plan
        layout = Layout(inputs=HISTORY_SIZE, actions=3, hidden=plan.hidden)
        self._learners = [Learner(layout, random) for _ in range(plan.networks)]

    def learn(
        self,
        histories: Histories,
        critic: Critic,
        random: np.random.Generator,
        after_epoch: Callable[[int, float], None],
    ) -> None:
        """Learn the critic's values from histories.

        Raises:
            TrainingDiverged: a loss is no finite number.
        """
        for epoch in range(self._plan.epochs):
            rate = self._plan.rate * 0.1 ** (epoch / self._plan.epochs)
            losses = [self._epoch(learner, histories, critic, random, rate) for learner in self._learners]
            after_epoch(epoch, float(np.mean(losses)))

    def weights(self) -> dict[str, FloatArray]:
        """Return the networks as `submission.policy.values` takes them."""
        return {
            f"{number}_{name}": value
            for number, each in enumerate(self._learners)
            for name, value in each.parameters.items()
        }

    def _epoch(
        self, learner: Learner, histories: Histories, critic: Critic, random: np.random.Generator, rate: float
    ) -> float:
        losses, order = [], random.permutation(len(histories.felt))
        for start in range(0, len(order), self._plan.batch):
            rows = order[start : start + self._plan.batch]
            felt, states = histories.felt[rows], histories.states[rows]
            actions = self._actions(states, critic, random)
            targets = probability(critic.log_odds(states, actions))
            if random.integers(2):
                felt, actions = mirrored_history(felt), actions * MIRROR_ACTION
            losses.append(learner.learn(felt, actions, targets, rate=rate))
        return float(np.mean(losses))

    def _actions(self, states: FloatArray, critic: Critic, random: np.random.Generator) -> FloatArray:
        """Draw the actions whose values are learned: a third of them near the best that the critic sees."""
        near = self._plan.actions // 3
        drawn = random.uniform(-1, 1, (len(states), self._plan.actions, 3)).astype(np.float32)
        best = drawn[np.arange(len(states)), critic.log_odds(states, drawn).argmax(axis=1)]
        noise = 0.25 * random.standard_normal((len(states), near, 3)).astype(np.float32)
        drawn[:, :near] = np.clip(best[:, None] + noise, -1, 1)
        return drawn


def histories_of(episodes: Episodes) -> Histories:
    """Return what a student learns from episodes: every moment at which an action was chosen."""
    starts = np.cumsum(episodes.lengths + 1) - (episodes.lengths + 1)
    firsts = np.repeat(starts, episodes.lengths)
    felt = [
        history_features(episodes.felt[first : first + step + 1], episodes.motions[first : first + step + 1], step)
        for first, step in zip(firsts.tolist(), episodes.step.tolist(), strict=True)
    ]
    shapes = np.repeat(episodes.shapes, episodes.lengths)
    states = states_of(episodes.truths[episodes.observations], shapes, episodes.step)
    return Histories(felt=np.array(felt, dtype=np.float32), states=states)


def mirrored_history(felt: FloatArray) -> FloatArray:
    """Return histories as a mirror with normal x shows them, shape [n, HISTORY_SIZE]."""
    return felt[:, _MIRROR_ORDER] * _MIRROR_SIGNS


def _mirror() -> tuple[NDArray[np.int64], FloatArray]:
    """Return from where each number of a mirrored history comes, and its sign: v turns round, x and theta too."""
    places = np.arange(FIELD_SIZE).reshape(2, len(GRID_V_PX), len(GRID_U_PX), 2)[:, ::-1].ravel()
    field_signs = np.tile([1.0, -1.0], FIELD_SIZE // 2)
    motion_signs = np.array([-1.0, 1.0, -1.0, 1.0])
    order = [*(places + FIELD_SIZE * number for number in range(3)), np.arange(3 * FIELD_SIZE, HISTORY_SIZE)]
    signs = [*([field_signs] * 3), motion_signs, motion_signs, np.ones(MOST_STEPS)]
    return np.concatenate(order), np.concatenate(signs).astype(np.float32)


_MIRROR_ORDER, _MIRROR_SIGNS = _mirror()
