"""How two logs differ, and how many of a log's actions a model gives; called by `vitac log diff` and `match`."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import takewhile, zip_longest
from typing import Any

import numpy as np
from pydantic import NonNegativeInt

from ..agent.verdicts import PolicyFailed
from ..episodes.episode import Environment, OpenSession, PlayingPolicy, Session, open_episode, public_part
from ..episodes.records import ActionSequence, EpisodeRecord, Reading, make_reading
from ..strict_model import StrictModel
from ..tracks import Task
from .log import LogHeader
from .recordings import Recording, make_recording


class EpisodeMatch(StrictModel):
    """One episode: how many of its actions the model gave, bit for bit, and the first env step where it did not."""

    episode: int
    actions: NonNegativeInt
    reproduced: NonNegativeInt
    first_mismatch: int | None
    failure: str | None = None
    """Why the model stopped giving actions."""


class ActionMatch(StrictModel):
    """The action match of a whole log."""

    episodes: tuple[EpisodeMatch, ...]

    @property
    def actions(self) -> int:
        """Actions in the log."""
        return sum(episode.actions for episode in self.episodes)

    @property
    def reproduced(self) -> int:
        """Actions that the model gave, too."""
        return sum(episode.reproduced for episode in self.episodes)


def match_actions(
    *,
    env: Environment,
    task: Task,
    records: Iterable[EpisodeRecord],
    open_session: OpenSession,
    reading: Reading | None = None,
    on_episode: Callable[[EpisodeMatch], None] = lambda _: None,
) -> ActionMatch:
    """Show a model the observations that the log's actions lead to, and compare its actions with the log's.

    The environment always follows the log, so one different action does not end the comparison.

    Args:
        env: environment of the task.
        task: task of the log.
        records: episodes of the log.
        open_session: returns a session with the loaded policy.
        reading: what the policy reads; all that the track lists by default.
        on_episode: called with each episode as soon as it is compared.

    Raises:
        PolicyFailed: the policy cannot be loaded.
        RecordingRejected: a record is of another task.
    """
    session = open_session()
    matched = []
    for record in records:
        matched.append(_match_episode(env, task, make_recording(record, task), session, reading or make_reading(task)))
        on_episode(matched[-1])
    return ActionMatch(episodes=tuple(matched))


def compare_actions(log: Mapping[int, ActionSequence], model: Mapping[int, ActionSequence]) -> ActionMatch:
    """Compare a log with a model's stored actions from the same starts, by episode number, without running either.

    Up to the first different action of an episode both had the same observations. Later actions cannot be compared
    and count as not reproduced.
    """
    return ActionMatch(
        episodes=tuple(_compare_episode(number, log[number], model.get(number)) for number in sorted(log))
    )


def _compare_episode(number: int, log: ActionSequence, model: ActionSequence | None) -> EpisodeMatch:
    ours = log.to_array()
    theirs = model.to_array() if model else ours[:0]
    equal = (one.tobytes() == other.tobytes() for one, other in zip(ours, theirs, strict=False))
    reproduced = sum(takewhile(bool, equal))
    complete = len(ours) == len(theirs) == reproduced
    return EpisodeMatch(
        episode=number, actions=len(ours), reproduced=reproduced, first_mismatch=None if complete else reproduced + 1
    )


def _match_episode(
    env: Environment, task: Task, recording: Recording, session: Session, reading: Reading
) -> EpisodeMatch:
    equal: list[bool] = []
    failure = None
    try:
        with open_episode(session, task, reading) as policy:
            equal.extend(
                _comparisons(env, task, recording, policy, reading)
            )  # Keeps what was compared before a failure.
    except PolicyFailed as failed:
        failure = str(failed)
    complete = len(equal) == len(recording.actions) and all(equal)
    return EpisodeMatch(
        episode=recording.episode.number,
        actions=len(recording.actions),
        reproduced=sum(equal),
        first_mismatch=None if complete else [*equal, False].index(False) + 1,
        failure=failure,
    )


def _comparisons(
    env: Environment, task: Task, recording: Recording, policy: PlayingPolicy, reading: Reading
) -> Iterator[bool]:
    observation, _ = env.reset(options=recording.episode.options)
    for action in recording.actions:
        answer = policy.act(public_part(task, reading, observation))
        yield answer.astype(np.float32).tobytes() == action.tobytes()
        observation, *_ = env.step(action)


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
