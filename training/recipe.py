"""What a training run does, as a file: every key is checked, an unknown one names the nearest valid one."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.tasks.registry import task_definitions
from vitac.envs.tasks.settings import Fidelity
from vitac.evaluator.strict_model import StrictModel, read_yaml

from .episodes import ENV_ID
from .learning.critic import Count, CriticPlan
from .learning.student import AssessorPlan, StudentPlan


class Recipe(StrictModel):
    """A training run of the peg task.

    A round plays episodes, learns critic and student from all episodes so far, and counts the student's successes from
    held-out starts. The first round's episodes are those of random and guided actors.
    """

    task: Literal["peg-insertion"]
    """What is learned."""
    seed: Annotated[int, Field(ge=0, le=10_000)]
    """Seed of the streams of starts and of all that is drawn while learning."""
    fidelity: Fidelity = Fidelity.FULL
    """Of the simulation that is learned from; rounds are judged at full fidelity."""
    contact_model: ContactModel = ContactModel.CHALLENGE_2025
    """Of all episodes, those by which rounds are judged too."""
    draws: dict[str, tuple[float, float]] = Field(default_factory=dict)
    """Quantities drawn for each episode, by name; without any as in 2025."""
    random_episodes: Count = 1500
    """Episodes of the actor with random motions."""
    guided_episodes: Count = 1500
    """Episodes of the actor that knows where the hole is; only the critic learns from them."""
    rounds: Annotated[int, Field(ge=1, le=100)] = 4
    """How often critic and student are learned."""
    student_episodes: Count = 1000
    """Episodes of the student after each round but the last."""
    critic_episodes: Count = 300
    """Episodes of the critic after each round but the last; only the critic learns from them."""
    noise: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    """Largest spread of the noise on the actions of student and critic."""
    chosen_by: Count = 100
    """Held-out episodes by which the best round is chosen."""
    critic: CriticPlan = CriticPlan()
    """How the critic is learned."""
    assessor: AssessorPlan = AssessorPlan()
    """How the assessor is learned."""
    assessed_from: Count = 4
    """First round in which the student learns of the assessor; before, of the critic."""
    assessments: Count = 2
    """How often the assessor assesses the student, and the student learns of it, in a round."""
    student: StudentPlan = StudentPlan()
    """How the student is learned."""

    @property
    def has_mirror_images(self) -> bool:
        """Whether what a mirror or half a turn shows of an episode is drawn as often as the episode itself.

        It is not where something lies to one side in all of them, such as the grasp of one station.
        """
        quantities = task_definitions()[ENV_ID].quantities
        sided = {quantity.name: self.draws.get(quantity.name) for quantity in quantities if quantity.two_sided}
        return all(
            (limits is None or sum(limits) == 0.0) and sided.get(name.replace("left_", "right_")) == limits
            for name, limits in sided.items()
        )

    @model_validator(mode="before")
    @classmethod
    def _is_not_of_a_search(cls, content: object) -> object:
        if isinstance(content, dict) and content.get("task") == "lock-opening":
            raise ValueError("a policy for lock-opening is searched; run `vitac train search` with this recipe")
        return content


def read_recipe(path: Path) -> Recipe:
    """Read a recipe.

    Raises:
        DocumentRejected: the file is no recipe; the message names what is wrong.
    """
    return read_yaml(Recipe, path)
