"""Demonstrations and the file that holds those of a task: one JSON line of where they come from, then one for each.

A demonstration is what is needed to play it again, and what was found: seed, actions and state hashes. What was seen is
not stored, because it follows from these (`frames`).
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Literal

from pydantic import Field, NonNegativeInt, PositiveInt, ValidationError
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, Manifest, StateHash, canonical_json
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.tracks import Task, find_task

FILE = "demonstrations.jsonl"
"""Name of the file in the folder of a task."""


class CollectionRejected(VitacError):
    """A file of demonstrations is not what was written, or another task's; the message names the line."""


class DemonstrationKind(StrEnum):
    """How the expert was made to act. Only the outcome says whether it succeeded."""

    CLEAN = "clean"
    """Its own actions; with noise only where nothing else succeeds."""
    NOISY = "noisy"
    """Its own actions, with noise in some of the first env steps, from which it recovers."""
    MISLED = "misled"
    """It goes to a place beside the target, which seldom succeeds."""


class Source(StrictModel):
    """Where demonstrations come from: what played them, and the seed of their starts."""

    format: Literal["vitac-demonstrations-1"] = "vitac-demonstrations-1"
    manifest: Manifest
    stream: NonNegativeInt
    """Episode n starts with `rng_seed = (stream, n)`."""

    @property
    def task(self) -> Task:
        """Return the task as this installation has it."""
        return find_task(self.manifest.task)[1]


class Demonstration(StrictModel):
    """An episode of the expert. `state_hashes` has one entry after the reset and one after each env step."""

    episode: PositiveInt
    kind: DemonstrationKind
    shape: Word
    outcome: EpisodeOutcome
    total_reward: float
    actions: ActionSequence
    state_hashes: tuple[StateHash, ...] = Field(min_length=1)

    @property
    def is_success(self) -> bool:
        """Whether the task was solved."""
        return self.outcome is EpisodeOutcome.SUCCESS

    def options(self, source: Source) -> Mapping[str, object]:
        """Return the options of `reset` with which it starts."""
        return {"rng_seed": (source.stream, self.episode)}


def make_line(content: Source | Demonstration) -> bytes:
    """Return the one line of some content."""
    return canonical_json(content.model_dump(mode="json")) + b"\n"


def read_source(path: Path) -> Source:
    """Return where the demonstrations of a file come from.

    Raises:
        CollectionRejected: it is no such file.
    """
    try:
        with path.open("rb") as file:
            return Source.model_validate_json(file.readline())
    except (OSError, ValidationError) as error:
        raise CollectionRejected(
            f"{path}:1 is not the first line of a file of demonstrations; make one with `vitac data collect`."
        ) from error


def read_demonstrations(path: Path) -> Iterator[Demonstration]:
    """Yield the demonstrations of a file, one at a time.

    Raises:
        CollectionRejected: a line is not what was written.
    """
    with path.open("rb") as file:
        file.readline()
        last = 0
        for number, line in enumerate(file, start=2):
            try:
                found = Demonstration.model_validate_json(line)
            except ValidationError as error:
                raise CollectionRejected(
                    f"{path}:{number} is no demonstration ({error.errors()[0]['msg']}); collect again into "
                    "another folder."
                ) from error
            if found.episode <= last:
                raise CollectionRejected(
                    f"{path}:{number} is episode {found.episode}, expected one after {last}; collect again into "
                    "another folder."
                )
            last = found.episode
            yield found
