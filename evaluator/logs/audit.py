"""How many of a log's actions does a model give? Called by `vitac log audit`, and by the server for a later model."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import takewhile

import numpy as np
from pydantic import NonNegativeInt

from ..agent.verdicts import PolicyFailed
from ..episodes.episode import Environment, OpenSession, Policy, Session, public_part
from ..episodes.records import ActionSequence, EpisodeRecord
from ..strict_model import StrictModel
from ..tracks import Task
from .recordings import Recording, recording_of


class AuditedEpisode(StrictModel):
    """One episode: how many of its actions the model gave to the last bit, and the first env step where it did not."""

    episode: int
    actions: NonNegativeInt
    reproduced: NonNegativeInt
    first_other: int | None
    failure: str | None = None
    """Why the model gave no more answers."""


class Audit(StrictModel):
    """All episodes of a log."""

    episodes: tuple[AuditedEpisode, ...]

    @property
    def actions(self) -> int:
        """Actions in the log."""
        return sum(episode.actions for episode in self.episodes)

    @property
    def reproduced(self) -> int:
        """Those that the model gave."""
        return sum(episode.reproduced for episode in self.episodes)


def audit(
    *,
    env: Environment,
    task: Task,
    records: Iterable[EpisodeRecord],
    open_session: OpenSession,
    on_episode: Callable[[AuditedEpisode], None] = lambda _: None,
) -> Audit:
    """Show a model what the log's actions lead to and compare what it would have done.

    The environment always follows the log, so one other action does not spoil the comparison of those after it.

    Args:
        env: environment of the task.
        task: what was played.
        records: of the log.
        open_session: gives the loaded policy.
        on_episode: gets each episode as soon as it is compared.

    Raises:
        PolicyFailed: the policy cannot be loaded.
        RecordingRejected: a record is of another task.
    """
    session = open_session()
    audited = []
    for record in records:
        audited.append(_audit_episode(env, task, recording_of(record, task), session))
        on_episode(audited[-1])
    return Audit(episodes=tuple(audited))


def compare_actions(log: Mapping[int, ActionSequence], model: Mapping[int, ActionSequence]) -> Audit:
    """Compare a log with what a model did from the same starts, by episode number, without playing anything.

    Up to the first other action of an episode both saw the same. What comes after it cannot be compared, and counts as
    not reproduced.
    """
    return Audit(episodes=tuple(_compare_episode(number, log[number], model.get(number)) for number in sorted(log)))


def _compare_episode(number: int, log: ActionSequence, model: ActionSequence | None) -> AuditedEpisode:
    ours, theirs = log.to_array(), model.to_array() if model else np.empty((0, log.shape[1]), np.float32)
    equal = (one.tobytes() == other.tobytes() for one, other in zip(ours, theirs, strict=False))
    reproduced = sum(takewhile(bool, equal))
    complete = len(ours) == len(theirs) == reproduced
    return AuditedEpisode(
        episode=number, actions=len(ours), reproduced=reproduced, first_other=None if complete else reproduced + 1
    )


def _audit_episode(env: Environment, task: Task, recording: Recording, session: Session) -> AuditedEpisode:
    equal: list[bool] = []
    failure = None
    try:
        with session.episode(task=task.name, action_shape=(len(task.actions),)) as policy:
            equal.extend(_comparisons(env, task, recording, policy))  # What came before a failure is kept.
    except PolicyFailed as failed:
        failure = str(failed)
    complete = len(equal) == len(recording.actions) and all(equal)
    return AuditedEpisode(
        episode=recording.episode.number,
        actions=len(recording.actions),
        reproduced=sum(equal),
        first_other=None if complete else [*equal, False].index(False) + 1,
        failure=failure,
    )


def _comparisons(env: Environment, task: Task, recording: Recording, policy: Policy) -> Iterator[bool]:
    observation, _ = env.reset(options=recording.episode.options)
    for action in recording.actions:
        answer = policy.act(public_part(task, observation))
        yield answer.astype(np.float32).tobytes() == action.tobytes()
        observation, *_ = env.step(action)
