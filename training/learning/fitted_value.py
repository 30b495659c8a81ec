"""A value of actions that is fitted in sweeps, each to targets of its own; what critic and assessor have in common."""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from .ensemble import Ensemble, Samples
from .network import FloatArray, Layout
from .symmetry import Signs


class FittingPlan(Protocol):
    """How a value is fitted; see `CriticPlan` and `AssessorPlan`."""

    @property
    def networks(self) -> int:
        """How many, of which the lowest value counts."""

    @property
    def hidden(self) -> int:
        """Units of both layers."""

    @property
    def sweeps(self) -> int:
        """Of targets."""

    @property
    def epochs(self) -> int:
        """Over all samples, in each sweep."""

    @property
    def batch(self) -> int:
        """Samples of a gradient step."""

    @property
    def rate(self) -> float:
        """Of learning."""


class FittedValue:
    """Networks that tell how likely success is after an action.

    Args:
        plan: how they are fitted.
        inputs: how many numbers they see beside the action.
        signs: how these change in mirror images.
        random: of the first weights.
    """

    def __init__(self, plan: FittingPlan, inputs: int, signs: Signs, random: np.random.Generator) -> None:
        self._fitting, self._signs = plan, signs
        self._ensemble = Ensemble(Layout(inputs=inputs, actions=3, hidden=plan.hidden), plan.networks, random)

    def log_odds(self, inputs: FloatArray, actions: FloatArray) -> FloatArray:
        """Return the log-odds of success after actions, shape [n, k]."""
        return self._ensemble.lowest(inputs, actions)

    def state(self) -> dict[str, FloatArray]:
        """Return the state that learning continues from."""
        return self._ensemble.state()

    def restore(self, state: Mapping[str, FloatArray]) -> None:
        """Continue from a state."""
        self._ensemble.restore(state)

    def _fit(
        self,
        samples: Samples,
        targets: Callable[[], FloatArray],
        random: np.random.Generator,
        after_sweep: Callable[[int, float], None],
    ) -> None:
        """Fit to the targets of each sweep, which are asked for at its beginning, shape [n].

        Raises:
            TrainingDiverged: a loss is no finite number.
        """
        plan = self._fitting
        for sweep in range(plan.sweeps):
            wanted = targets()
            losses = [
                self._ensemble.epoch(samples, wanted, self._signs, random, batch=plan.batch, rate=plan.rate)
                for _ in range(plan.epochs)
            ]
            after_sweep(sweep, float(np.mean(losses)))
