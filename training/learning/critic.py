"""The critic: probability of success of an action where the truth is known, by fitted Q iteration.

Several small networks, of which the lowest value counts (Fujimoto et al. 2018), learn from all episodes and their
mirror images. The targets of a sweep are their own values of the best of random next actions (Ernst et al. 2005).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from ..episodes import Episodes
from .adam import FloatArray
from .ensemble import Samples
from .fitted_value import Count, FittedValue, FittingPlan
from .network import probability
from .symmetry import STATE, TURNABLE

STATE_SIZE = 15
SHAPES = 3
_FIRST_LOWER_END_MM, _Z_STEP_MM = 19.875, 0.125
_CHUNK = 4096


class CriticPlan(FittingPlan):
    """How a critic is learned."""

    networks: Count = 3
    hidden: Count = 64
    sweeps: Count = 12
    epochs: Count = 4
    batch: Count = 128
    rate: PositiveFloat = 2e-3
    discount: float = 0.97
    candidates: Count = 64
    """Next actions among which the best is looked for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Transitions:
    """What a critic learns from; states of shape [n, STATE_SIZE] before and after the actions, shape [n, 3]."""

    before: FloatArray
    after: FloatArray
    actions: FloatArray
    reached: NDArray[np.bool_]
    last: NDArray[np.bool_]
    turnable: NDArray[np.bool_]


class Critic(FittedValue):
    """Networks that see the truth."""

    def __init__(self, plan: CriticPlan, random: np.random.Generator) -> None:
        super().__init__(plan, STATE_SIZE, STATE, random)
        self._plan = plan

    def learn(self, episodes: Episodes, random: np.random.Generator, after_sweep: Callable[[int, float], None]) -> None:
        """Learn from episodes, starting from what is known.

        Args:
            episodes: all that there are.
            random: of the batches and the next actions.
            after_sweep: called with the number of each sweep and its mean loss.

        Raises:
            TrainingDiverged: a loss is no finite number.
        """
        known = transitions(episodes)
        samples = Samples(inputs=known.before, actions=known.actions, turnable=known.turnable)
        self._fit(samples, lambda: self._targets(known, random), random, after_sweep)

    @classmethod
    def from_state(cls, plan: CriticPlan, state: Mapping[str, FloatArray]) -> "Critic":
        """Return a critic that continues from a state."""
        critic = cls(plan, np.random.default_rng(0))
        critic.restore(state)
        return critic

    def _targets(self, known: Transitions, random: np.random.Generator) -> FloatArray:
        best = np.zeros(len(known.actions), dtype=np.float32)
        running = np.flatnonzero(~known.last)
        for start in range(0, len(running), _CHUNK):
            rows = running[start : start + _CHUNK]
            candidates = random.uniform(-1, 1, (self._plan.candidates, 3)).astype(np.float32)
            best[rows] = probability(self.log_odds(known.after[rows], candidates).max(axis=1))
        return np.where(known.reached, np.float32(1.0), np.float32(self._plan.discount) * best)


def transitions(episodes: Episodes) -> Transitions:
    """Return what a critic learns from episodes."""
    before, shapes = episodes.observations, np.repeat(episodes.shapes, episodes.lengths)
    return Transitions(
        before=stack_states(episodes.truths[before], shapes, episodes.step),
        after=stack_states(episodes.truths[before + 1], shapes, episodes.step + 1),
        actions=episodes.actions,
        reached=episodes.reached,
        last=episodes.last,
        turnable=np.isin(shapes, TURNABLE),
    )


def stack_states(truths: FloatArray, shapes: NDArray[np.int64], steps: NDArray[np.int64]) -> FloatArray:
    """Return what a critic sees, shape [n, STATE_SIZE].

    Args:
        truths: offset (x, y, theta) and measured pose (x, y, z, roll, pitch, yaw) [mm, deg], shape [n, 9].
        shapes: numbers of the shapes, shape [n].
        steps: env steps played so far, shape [n].
    """
    x, y, theta = truths[:, :3].T
    measured = truths[:, 3:]
    sine, cosine = np.sin(np.radians(theta)), np.cos(np.radians(theta))
    height = measured[:, 2] - (_FIRST_LOWER_END_MM - _Z_STEP_MM * steps)
    columns = [
        *(x / 4, y / 4, theta / 8, (cosine * x + sine * y) / 4, (cosine * y - sine * x) / 4),
        *(measured[:, 0] - x, measured[:, 1] - y, height),
        *(measured[:, 3], measured[:, 4], measured[:, 5] - theta),
        steps / 8,
        *(shapes == number for number in range(SHAPES)),
    ]
    return np.column_stack(columns).astype(np.float32)
