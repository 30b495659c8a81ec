"""What a round learns: the critic, the assessor and the student, each continuing from the round before."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .collection import ActorKind, Networks
from .episodes import Episodes, joined
from .learning.critic import Critic
from .learning.network import FloatArray
from .learning.student import Assessor, Student, assessed, fit_belief, make_histories, make_weights
from .recipe import Recipe

Known = Sequence[tuple[ActorKind, Episodes]]
"""Episodes, and whose they are."""
TellTurn = Callable[[str, int, float], None]
"""Called with who has learned, the number of the turn, and its loss."""


class Learners:
    """Critic, assessor and student of a run.

    Args:
        recipe: of the run.
        random: of the first weights.
    """

    def __init__(self, recipe: Recipe, random: np.random.Generator) -> None:
        self._recipe = recipe
        images = recipe.has_mirror_images
        self._critic = Critic(recipe.critic, random, images=images)
        self._assessor = Assessor(recipe.assessor, random, images=images)
        self._student = Student(recipe.student, random, images=images)
        self._belief: FloatArray = np.zeros((0, 3), dtype=np.float32)

    def learn(self, known: Known, number: int, random: np.random.Generator, tell: TellTurn) -> None:
        """Learn a round from all episodes so far.

        Raises:
            TrainingDiverged: a loss is no finite number.
        """
        played = joined([episodes for _, episodes in known])
        self._critic.learn(played, random, lambda turn, loss: tell("critic", turn, loss))
        if number < self._recipe.assessed_from:
            self._learn_of_critic(known, random, tell)
        else:
            self._learn_of_assessor(known, played, random, tell)
        self._belief = fit_belief(make_weights(self._student.state()), _select_without_truth(known))

    def networks(self) -> Networks:
        """Return what actors act by."""
        plan = self._recipe.critic
        return Networks(plan=plan, critic=self._critic.state(), student=make_weights(self._student.state()))

    def state(self) -> dict[str, FloatArray]:
        """Return the state that the next round continues from."""
        learners = (("critic", self._critic), ("assessor", self._assessor), ("student", self._student))
        states = {f"{name}.{key}": value for name, learner in learners for key, value in learner.state().items()}
        return {**states, "belief": self._belief}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from a state."""
        self._critic.restore(part(stored, "critic"))
        self._assessor.restore(part(stored, "assessor"))
        self._student.restore(part(stored, "student"))
        self._belief = stored["belief"]

    def _learn_of_critic(self, known: Known, random: np.random.Generator, tell: TellTurn) -> None:
        """Give the student the values of one who will know the truth from now on."""
        histories = make_histories(_select_without_truth(known))

        def estimate_value(rows: Any, actions: FloatArray) -> FloatArray:
            return self._critic.log_odds(histories.states[rows], actions)

        self._student.learn(histories, estimate_value, random, lambda turn, loss: tell("student", turn, loss))

    def _learn_of_assessor(self, known: Known, played: Episodes, random: np.random.Generator, tell: TellTurn) -> None:
        """Update the student's values to those of its own policy, which changes what it does."""
        histories, transitions = make_histories(_select_without_truth(known)), assessed(played)
        inputs = np.concatenate([histories.states, histories.felt], axis=1)

        def estimate_value(rows: Any, actions: FloatArray) -> FloatArray:
            return self._assessor.log_odds(inputs[rows], actions)

        for _ in range(self._recipe.assessments):
            following = self._student.best(transitions.felt, random)
            self._assessor.learn(transitions, following, random, lambda turn, loss: tell("assessor", turn, loss))
            self._student.learn(histories, estimate_value, random, lambda turn, loss: tell("student", turn, loss))


def _select_without_truth(known: Known) -> Episodes:
    """Return the episodes whose actions no truth has chosen."""
    return joined([episodes for kind, episodes in known if not kind.knows_truth])


def part(stored: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return what a state holds of the critic, the assessor or the student."""
    return {key.removeprefix(f"{name}."): value for key, value in stored.items() if key.startswith(f"{name}.")}
