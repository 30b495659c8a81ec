"""A value of actions that is fitted in sweeps, each to targets of its own; what critic and assessor have in common."""

from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveFloat
from vitac.evaluator.strict_model import StrictModel

from .adam import FloatArray
from .ensemble import Ensemble, Samples
from .network import Layout
from .symmetry import Signs

Count = Annotated[int, Field(ge=1, le=1_000_000)]


class FittingPlan(StrictModel):
    """How a value is fitted, as recipes say it."""

    networks: Count
    """How many, of which the lowest value counts."""
    hidden: Count
    """Units of both layers."""
    sweeps: Count
    """Sweeps of targets each time."""
    epochs: Count
    """Passes over all samples in each sweep."""
    batch: Count
    """Samples of a gradient step."""
    rate: PositiveFloat
    """Learning rate."""
    discount: Annotated[float, Field(gt=0.0, le=1.0)]
    """Discount of an env step, so that sooner is better."""


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
