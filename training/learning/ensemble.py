"""Several networks for one value, and how they learn it from samples with their mirror images.

Critic, assessor and student are such ensembles.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .adam import FloatArray
from .network import Layout, Learner, logits
from .symmetry import Signs


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """What an ensemble learns from, a row each.

    Attributes:
        inputs: shape [n, i].
        actions: shape [n, 3].
        turnable: whether half a turn changes nothing, shape [n].
    """

    inputs: FloatArray
    actions: FloatArray
    turnable: NDArray[np.bool_]


class Ensemble:
    """Networks that learn the probability of success of an action, each from weights of its own.

    Args:
        layout: of each network.
        count: how many networks.
        random: of the first weights.

    Attributes:
        learners: the networks.
    """

    def __init__(self, layout: Layout, count: int, random: np.random.Generator) -> None:
        self.learners = [Learner(layout, random) for _ in range(count)]

    def lowest(self, inputs: FloatArray, actions: FloatArray) -> FloatArray:
        """Return the lowest log-odds of success of actions, shape [n, k]; see `network.logits`."""
        return np.asarray(np.minimum.reduce(self._log_odds(inputs, actions)))

    def mean(self, inputs: FloatArray, actions: FloatArray) -> FloatArray:
        """Return the mean log-odds of success of actions, shape [n, k]; see `network.logits`."""
        return np.asarray(np.mean(self._log_odds(inputs, actions), axis=0))

    def epoch(
        self,
        samples: Samples,
        targets: FloatArray,
        signs: Signs,
        random: np.random.Generator,
        *,
        batch: int,
        rate: float,
    ) -> float:
        """Learn once from every sample, as it is or as a mirror or half a turn shows it, and return the mean loss.

        Raises:
            TrainingDiverged: the loss is no finite number.
        """
        losses = []
        for learner in self.learners:
            order = random.permutation(len(targets))
            for start in range(0, len(order), batch):
                rows = order[start : start + batch]
                inputs, actions = signs.drawn(
                    samples.inputs[rows], samples.actions[rows], samples.turnable[rows], random
                )
                losses.append(learner.learn(inputs, actions[:, None], targets[rows, None], rate=rate))
        return float(np.mean(losses))

    def state(self) -> dict[str, FloatArray]:
        """Return the state that learning continues from."""
        return {
            f"{number}.{name}": value
            for number, each in enumerate(self.learners)
            for name, value in each.adam.state().items()
        }

    def restore(self, state: Mapping[str, FloatArray]) -> None:
        """Continue from a state."""
        for number, each in enumerate(self.learners):
            own = f"{number}."
            each.adam.restore({name.removeprefix(own): value for name, value in state.items() if name.startswith(own)})

    def _log_odds(self, inputs: FloatArray, actions: FloatArray) -> list[FloatArray]:
        return [logits(each.parameters, inputs, actions) for each in self.learners]
