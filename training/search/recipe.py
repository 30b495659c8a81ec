"""What a search does, as a file: every key is checked, an unknown one names the nearest valid one."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from vitac.evaluator.strict_model import StrictModel, read_yaml

Count = Annotated[int, Field(ge=1, le=100_000)]


class SearchRecipe(StrictModel):
    """A search of the lock task."""

    task: Literal["lock-opening"]
    """What is learned."""
    seed: Annotated[int, Field(ge=0, le=10_000)]
    """Seed of the streams of starts and of all that is drawn."""
    generations: Annotated[int, Field(ge=1, le=1000)] = 12
    """How often candidates are drawn."""
    candidates: Count = 32
    """Policies of a generation."""
    kept: Count = 8
    """The best of them, around which the next ones are drawn."""
    episodes: Count = 8
    """Episodes that each candidate plays, from the same starts as the others."""
    chosen_by: Count = 100
    """Held-out episodes by which the best generation is chosen."""

    @model_validator(mode="before")
    @classmethod
    def _is_not_of_a_training(cls, content: object) -> object:
        if isinstance(content, dict) and content.get("task") == "peg-insertion":
            raise ValueError("a policy for peg-insertion is trained in rounds; run `vitac train` with this recipe")
        return content

    @model_validator(mode="after")
    def _keeps_some(self) -> "SearchRecipe":
        if self.kept > self.candidates:
            raise ValueError(f"'kept' is {self.kept}, expected at most the number of candidates, {self.candidates}")
        return self


def read_search_recipe(path: Path) -> SearchRecipe:
    """Read the recipe of a search.

    Raises:
        DocumentRejected: the file is no such recipe; the message names what is wrong.
    """
    return read_yaml(SearchRecipe, path)
