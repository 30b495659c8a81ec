"""How many of a log's actions does a model give? Called by `vitac log match`, and by the server for a later model."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import takewhile

import numpy as np
from pydantic import NonNegativeInt

from ..agent.verdicts import PolicyFailed
from ..episodes.episode import Environment, OpenSession, Policy, Session, open_episode, public_part
from ..episodes.reading import Reading, make_reading
from ..episodes.records import ActionSequence, EpisodeRecord
from ..strict_model import StrictModel
from ..tracks import Task
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
    env: Environment, task: Task, recording: Recording, policy: Policy, reading: Reading
) -> Iterator[bool]:
    observation, _ = env.reset(options=recording.episode.options)
    for action in recording.actions:
        answer = policy.act(public_part(task, reading, observation))
        yield answer.astype(np.float32).tobytes() == action.tobytes()
        observation, *_ = env.step(action)
