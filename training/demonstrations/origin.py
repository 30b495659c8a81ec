"""The file of a data set that says where its episodes come from, which its format has no place for."""

from pathlib import Path
from typing import Self

from pydantic import ValidationError
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeOutcome, StateHash
from vitac.evaluator.strict_model import StrictModel, Word

from ..files import write_text
from .demonstration import Demonstration, DemonstrationKind, Source

ORIGIN = Path("meta/vitac.json")
"""Its name in the folder of the data set."""


class NotOurs(VitacError):
    """A data set does not say where its episodes come from, so they cannot be played again."""


class StoredEpisode(StrictModel):
    """What the table of a data set does not say of a demonstration."""

    episode: int
    kind: DemonstrationKind
    shape: Word
    outcome: EpisodeOutcome
    total_reward: float
    final_state_hash: StateHash

    @classmethod
    def of(cls, demonstration: Demonstration) -> Self:
        """Return that of a demonstration."""
        return cls(
            episode=demonstration.episode,
            kind=demonstration.kind,
            shape=demonstration.shape,
            outcome=demonstration.outcome,
            total_reward=demonstration.total_reward,
            final_state_hash=demonstration.state_hashes[-1],
        )


class Origin(StrictModel):
    """Where the episodes of a data set come from."""

    source: Source
    episodes: tuple[StoredEpisode, ...]


def write_origin(folder: Path, origin: Origin) -> None:
    """Write the file of a data set.

    Raises:
        NotSaved: it cannot be written.
    """
    write_text(folder / ORIGIN, origin.model_dump_json(indent=1) + "\n")


def read_origin(folder: Path) -> Origin:
    """Read the file of a data set.

    Raises:
        NotOurs: there is none.
    """
    try:
        return Origin.model_validate_json((folder / ORIGIN).read_text())
    except (OSError, ValidationError) as error:
        raise NotOurs(
            f"{folder / ORIGIN} cannot be read, expected what `vitac data export` writes. Only such data sets say how "
            "their episodes started, which a replay needs."
        ) from error
