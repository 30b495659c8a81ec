"""The first difference between two logs; called by `vitac log diff`."""

from collections.abc import Iterable
from itertools import zip_longest
from typing import Any

from ..episodes.records import EpisodeRecord
from ..strict_model import StrictModel
from .log import LogHeader


class LogDifference(StrictModel):
    """The first difference between two logs; no episode means the header, no env step the whole episode."""

    episode: int | None = None
    env_step: int | None = None
    key: str
    first: Any
    second: Any


def first_difference(
    first: tuple[LogHeader, Iterable[EpisodeRecord]], second: tuple[LogHeader, Iterable[EpisodeRecord]]
) -> LogDifference | None:
    """Return the first difference between the episodes of two logs, or None; team and submission are not compared."""
    ours, theirs = first[0].manifest, second[0].manifest
    for key in type(ours).model_fields:
        if getattr(ours, key) != getattr(theirs, key):
            return LogDifference(key=key, first=getattr(ours, key), second=getattr(theirs, key))
    for one, other in zip_longest(first[1], second[1]):
        difference = _difference(one, other)
        if difference:
            return difference
    return None


def _difference(one: EpisodeRecord | None, other: EpisodeRecord | None) -> LogDifference | None:
    if one is None or other is None or one.episode != other.episode:
        numbers = [record.episode if record else None for record in (one, other)]
        number = min(number for number in numbers if number is not None)
        return LogDifference(episode=number, key="episode", first=numbers[0], second=numbers[1])
    for key in ("task", "shape", "initial_offset"):
        if getattr(one, key) != getattr(other, key):
            return LogDifference(episode=one.episode, key=key, first=getattr(one, key), second=getattr(other, key))
    return _difference_in_steps(one, other) or _difference_at_the_end(one, other)


def _difference_in_steps(one: EpisodeRecord, other: EpisodeRecord) -> LogDifference | None:
    actions = one.actions.to_array().tolist(), other.actions.to_array().tolist()
    for step in range(min(one.env_steps, other.env_steps) + 1):
        pairs = [("state_hash", one.state_hashes[step], other.state_hashes[step])]
        if step:
            pairs = [("action", actions[0][step - 1], actions[1][step - 1]), *pairs]
        for key, first, second in pairs:
            if first != second:
                return LogDifference(episode=one.episode, env_step=step, key=key, first=first, second=second)
    return None


def _difference_at_the_end(one: EpisodeRecord, other: EpisodeRecord) -> LogDifference | None:
    for key in ("env_steps", "outcome", "picture"):
        if getattr(one, key) != getattr(other, key):
            return LogDifference(episode=one.episode, key=key, first=getattr(one, key), second=getattr(other, key))
    return None
