"""The assessor: probability that the student succeeds after an action, where the truth is known too.

It evaluates the student's policy by temporal differences: the value of the next action is that of the one which the
student would take, by what it would have felt. So what an action tells about the hole has its value, which a critic
that always knows the truth does not see (asymmetric actor-critic: Pinto et al. 2018, Baisero and Amato 2022).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from ..episodes import Episodes
from ..submission.policy import HISTORY_SIZE
from .adam import FloatArray
from .critic import STATE_SIZE, transitions
from .ensemble import Samples
from .fitted_value import Count, FittedValue, FittingPlan
from .network import probability
from .student import student_inputs
from .symmetry import HISTORY, STATE, both

_SIGNS = both(STATE, HISTORY)


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

    def __init__(self, plan: AssessorPlan, random: np.random.Generator) -> None:
        super().__init__(plan, STATE_SIZE + HISTORY_SIZE, _SIGNS, random)
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
