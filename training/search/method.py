"""The cross-entropy method (Rubinstein 1999, Mannor et al. 2003): no gradients and no truth, only how episodes end.

A generation draws candidates around a mean, lets all play the same starts, and takes mean and spread of the best. What
is drawn follows from the recipe's seed and the number of the generation, so that a search that was stopped ends with
the same bits as one that was not, however many processes play.
"""

import io
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator
from vitac.errors import VitacError
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import Rate, rate
from vitac.evaluator.strict_model import StrictModel, read_yaml
from vitac.evaluator.tracks import find_task

from ..files import load, save, write_bytes, write_text
from ..log import Charts, Row, extend_log, read_log
from ..pool import map_in_order
from ..progress import TrainingProgress
from ..run import Folder, Tell, claimed, format_rate
from ..streams import Use, stream
from . import policy
from .policy import ACTIONS, FEATURES, FloatArray, Opening

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


LONGEST_ENV_STEPS = 9
"""Number of env steps after which an episode of the search counts as not solved; a good one takes five."""
ENV_STEP_COST = 0.05
"""Cost of an env step, where success is worth 1."""
FIRST_PULL, FIRST_LIFT = 0.5, 1.0
"""Actions around which the first candidates are drawn: a key comes out and up."""
FIRST_SPREAD = 0.5
"""Spread of each weight in the first generation."""
LEAST_SPREAD = 0.05
"""So that candidates differ to the end."""
_GENERATION_NUMBERS = 100_000
"""Numbers of episodes that each generation has of its own."""

MakeEnvironment = Callable[[], Any]


def lock_environment() -> Any:
    """Return the environment of the lock task as policies are scored in it."""
    return make_environment(find_task("lock-opening")[1])


class NothingSolved(VitacError):
    """No candidate solved an episode, so none is better than another; give more candidates or episodes."""


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How an episode ended.

    Attributes:
        solved: whether with success.
        env_steps: played.
    """

    solved: bool
    env_steps: int

    @property
    def worth(self) -> float:
        """What a candidate gets for it, 0 to 1."""
        return 1.0 - ENV_STEP_COST * self.env_steps if self.solved else 0.0


@dataclass(frozen=True, kw_only=True)
class Generation:
    """What a generation found.

    Attributes:
        number: from 1.
        solved: successes of its mean from the starts by which the best is chosen.
        mean_env_steps: of these successes; 0 without any.
    """

    number: int
    solved: Rate
    mean_env_steps: float


@dataclass(kw_only=True, eq=False)
class WeightSearch:
    """A search for the weights of a policy.

    Attributes:
        recipe: what is done.
        folder: where its files are.
        processes: how many play episodes.
        tell: called with a line for each generation.
        make: makes the environment of a process.
    """

    recipe: SearchRecipe
    folder: Folder
    processes: int = 1
    tell: Tell = field(default=lambda _: None)
    make: MakeEnvironment = field(default_factory=lambda: lock_environment)

    def go(self) -> list[Generation]:
        """Do what is left of the search, write the submission of the best generation, and return all of them.

        Raises:
            NothingSolved: no candidate of a generation solved an episode.
            NotSaved: the disk is full.
            FolderInUse: another process writes there.
            OtherRun: the folder is that of another recipe or version.
            FileDamaged: what a generation found, or the log, is not what was written.
        """
        with claimed(self.folder.path, self.recipe.model_dump(mode="json"), self.tell):
            with Charts(self.folder.path, self.tell) as charts:
                generations = self._generations(charts)
            chosen = best(generations)
            export(load(self.folder.networks(chosen.number))["mean"], self.folder.path / "submission")
            return generations

    def _generations(self, charts: Charts) -> list[Generation]:
        mean, spread = np.zeros((ACTIONS, FEATURES)), np.full((ACTIONS, FEATURES), FIRST_SPREAD)
        mean[:, 0] = -FIRST_PULL, -FIRST_LIFT
        judged = {generation.number: generation for generation in read_log(self.folder.log, _generation)}
        generations: list[Generation] = []
        numbers = range(1, self.recipe.generations + 1)
        progress = TrainingProgress()
        progress.left(sum(self.folder.networks(number).exists() for number in numbers), len(numbers))
        for number in numbers:
            mean, spread = self._next(number, mean, spread)
            generations.append(judged.get(number) or self._judged(number, mean))
            if number not in judged:  # before the log: a kill in between charts it twice rather than never
                charts.add_row(number, _row(generations[-1]))
            extend_log(self.folder.log, [_row(generation) for generation in generations])
            self._tell_generation(generations[-1], progress.left(number, len(numbers)))
        return generations

    def _next(self, number: int, mean: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and spread of the best of a generation, or read what they were."""
        path = self.folder.networks(number)
        if not path.exists():
            random = np.random.default_rng((self.recipe.seed, number))
            drawn = mean + spread * random.standard_normal((self.recipe.candidates, *mean.shape))
            worth = self._worth(drawn, number)
            if not worth.any():
                raise NothingSolved(
                    f"No candidate of generation {number} solved any of {self.recipe.episodes} episodes; "
                    "give more candidates or episodes, or another seed."
                )
            kept = drawn[np.argsort(-worth, kind="stable")[: self.recipe.kept]]
            save(path, {"mean": kept.mean(axis=0), "spread": np.maximum(kept.std(axis=0), LEAST_SPREAD)})
        stored = load(path)
        return stored["mean"], stored["spread"]

    def _worth(self, candidates: FloatArray, number: int) -> FloatArray:
        """Return the mean worth of the episodes of each candidate."""
        starts = self._starts(Use.COLLECT, number * _GENERATION_NUMBERS, self.recipe.episodes)
        endings = self._played([(weights, start) for weights in candidates for start in starts])
        worth = np.array([ending.worth for ending in endings])
        return np.asarray(worth.reshape(len(candidates), -1).mean(axis=1))

    def _judged(self, number: int, mean: FloatArray) -> Generation:
        endings = self._played([(mean, start) for start in self._starts(Use.CHOOSE, 0, self.recipe.chosen_by)])
        solved = [ending.env_steps for ending in endings if ending.solved]
        return Generation(
            number=number,
            solved=rate(len(solved), len(endings)),
            mean_env_steps=sum(solved) / len(solved) if solved else 0.0,
        )

    def _tell_generation(self, generation: Generation, left: str) -> None:
        solved = f"{format_rate(generation.solved)} in {generation.mean_env_steps:.2f} env steps"
        self.tell(f"generation {generation.number} of {self.recipe.generations}: {solved}{left}")

    def _starts(self, use: Use, first: int, count: int) -> list[tuple[int, int]]:
        seed = stream(self.recipe.seed, use)
        return [(seed, first + number) for number in range(count)]

    def _played(self, works: Sequence[tuple[FloatArray, tuple[int, int]]]) -> list[Ending]:
        playing = partial(_play, self.make)
        _environment(self.make)  # Loaded here, so that it is in every process that is forked.
        return list(map_in_order(playing, works, self.processes))


def best(generations: Iterable[Generation]) -> Generation:
    """Return the generation with the most successes, of these with the fewest env steps, and of equals the latest."""
    return max(generations, key=lambda each: (each.solved.successes, -each.mean_env_steps, each.number))


def export(weights: FloatArray, folder: Path) -> None:
    """Write the submission of a policy with these weights.

    Raises:
        NotSaved: it cannot be written.
    """
    track = folder / "Track_1"
    packed = io.BytesIO()
    np.savez(packed, weights=weights.round(4))
    write_bytes(track / "weights.npz", packed.getvalue())
    write_text(
        track / "submission.yaml",
        "track: track_1\ntasks: [lock-opening]\nname: sixteen numbers\nentry_point: policy:Policy\n"
        "observation_keys: [marker_flow]\n",
    )
    shutil.copyfile(str(policy.__file__), track / "policy.py")


def play(env: Any, weights: FloatArray, start: tuple[int, int]) -> Ending:
    """Play an episode of a stream, at most `LONGEST_ENV_STEPS`."""
    observation, _ = env.reset(options={"rng_seed": start})
    opening = Opening(weights)
    for env_steps in range(1, LONGEST_ENV_STEPS + 1):
        observation, _, terminated, truncated, info = env.step(opening.act(observation["marker_flow"]))
        if terminated or truncated:
            return Ending(solved=bool(info["is_success"]), env_steps=env_steps)
    return Ending(solved=False, env_steps=LONGEST_ENV_STEPS)


def _row(each: Generation) -> Row:
    return {"generation": each.number, "solved": each.solved.model_dump(), "mean_env_steps": each.mean_env_steps}


def _generation(row: Row) -> Generation:
    solved = Rate.model_validate(row["solved"])
    return Generation(number=row["generation"], solved=solved, mean_env_steps=row["mean_env_steps"])


@cache
def _environment(make: MakeEnvironment) -> Any:
    """Return the environment of this process; one that is made before a fork is there in the other, too."""
    return make()


def _play(make: MakeEnvironment, work: tuple[FloatArray, tuple[int, int]]) -> Ending:
    return play(_environment(make), *work)
