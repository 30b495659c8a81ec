"""Who acts in the episodes that are learned from; only some of them know no truth."""

from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .episodes import Actor, FloatArray, MakeActor, Moment
from .learning.critic import Critic, stack_states
from .submission.policy import CANDIDATES, candidate_actions, values


class ActorKind(StrEnum):
    """Kinds of actors."""

    RANDOM = "random"
    """Random motions of a size that each episode has of its own."""
    GUIDED = "guided"
    """Knows the offset and moves towards the hole, with noise."""
    CRITIC = "critic"
    """Knows the truth and takes the critic's best action, with noise."""
    STUDENT = "student"
    """Takes the student's best action, with noise."""

    @property
    def knows_truth(self) -> bool:
        """Whether its actions depend on what no policy sees, so that its histories must not teach a student."""
        return self in (ActorKind.GUIDED, ActorKind.CRITIC)


MOTION = np.array([2.0, 2.0, 4.0])
"""Motion of an action of 1 [mm, mm, deg]."""
_GRID = candidate_actions(CANDIDATES)


def random_actor(random: np.random.Generator) -> Actor:
    """Return an actor whose motions are all small or all large."""
    size = random.uniform(0.2, 1.0)
    return lambda _: np.asarray(size * random.uniform(-1, 1, 3), dtype=np.float32)


def guided_actor(random: np.random.Generator) -> Actor:
    """Return an actor that goes to the hole, more or less straight."""
    spread = random.uniform(0.0, 0.6)

    def act(moment: Moment) -> FloatArray:
        x, y, theta = moment.truth[:3].tolist()
        sine, cosine = np.sin(np.radians(theta)), np.cos(np.radians(theta))
        way = np.array([-cosine * x - sine * y, sine * x - cosine * y, -theta]) / MOTION
        return _noisy(way, spread, random)

    return act


def critic_actor(critic: Critic, noise: float) -> MakeActor:
    """Return what makes actors that take the critic's best action with some noise."""

    def make(random: np.random.Generator) -> Actor:
        spread = noise * random.uniform()

        def act(moment: Moment) -> FloatArray:
            state = stack_states(moment.truth[None], np.array([moment.shape]), np.array([moment.step]))
            return _noisy(_GRID[int(critic.log_odds(state, _GRID)[0].argmax())], spread, random)

        return act

    return make


def student_actor(weights: dict[str, Any], noise: float) -> MakeActor:
    """Return what makes actors that take a student's best action with some noise."""

    def make(random: np.random.Generator) -> Actor:
        spread = noise * random.uniform()

        def act(moment: Moment) -> FloatArray:
            best = int(np.argmax(values(weights, moment.history.features(), _GRID)))
            return _noisy(_GRID[best], spread, random)

        return act

    return make


def _noisy(action: NDArray[Any], spread: float, random: np.random.Generator) -> FloatArray:
    return np.asarray(np.clip(action + spread * random.standard_normal(3), -1, 1), dtype=np.float32)
