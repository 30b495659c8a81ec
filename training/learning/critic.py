"""The critic: probability of success of an action where the truth is known, by fitted Q iteration.

Several small networks, of which the lowest value counts (Fujimoto et al. 2018), learn from all episodes and their
mirror images. Ensembles and values fitted in sweeps are what assessor and student have, too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat
from vitac.evaluator.strict_model import StrictModel

from ..episodes import Episodes
from .network import STATE, TURNABLE, FloatArray, Layout, Learner, Signs, logits, probability


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

    def __init__(self, plan: CriticPlan, random: np.random.Generator, *, images: bool = True) -> None:
        super().__init__(plan, STATE_SIZE, replace(STATE, are_drawn=images), random)
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
