"""Selects the env step of an episode whose pictures its record names by their hash; called where episodes are played.

The step is the one with the smallest ticket, the SHA-256 of the list's seed, the episode's number and the state hash.
Every state thus has the same chance, nobody knows the step before the episode is over, and another step means other
states.
"""

import hashlib
from typing import Protocol

from ..tracks import Episode
from .records import SampledPicture


class HasPictures(Protocol):
    """What pictures are taken of: an environment."""

    def state_hash(self) -> str:
        """Return the SHA-256 [hex] of the physical state."""

    def picture_hash(self) -> str | None:
        """Return the SHA-256 [hex] of what the task's cameras see now; None where it has none."""


class PictureSample:
    """Follows an episode; hashes pictures only where a ticket is smaller than all before: about 4 times in 25 steps.

    Attributes:
        picture: those of the env step with the smallest ticket so far; None where the task has no cameras.
    """

    def __init__(self, env: HasPictures, episode: Episode) -> None:
        self._env = env
        self._episode = f"{episode.list_seed} {episode.number}"
        self._smallest: str | None = None
        self.picture: SampledPicture | None = None

    def look(self, env_step: int) -> str:
        """Take the state after an env step, or after the reset (0), into account, and return its hash."""
        state_hash = self._env.state_hash()
        ticket = hashlib.sha256(f"{self._episode} {state_hash}".encode()).hexdigest()
        if self._smallest is None or ticket < self._smallest:
            self._smallest = ticket
            pictures = self._env.picture_hash()
            self.picture = None if pictures is None else SampledPicture(env_step=env_step, sha256=pictures)
        return state_hash
