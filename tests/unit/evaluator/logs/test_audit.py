from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import pytest
from evaluation_fakes import Answer, FakeEnvironment, FakePolicy, FakeSession, action, fail, small_track, succeed
from numpy.typing import NDArray
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.episode import run_episode
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.logs.audit import Audit, audit, compare_actions

TASK = small_track().tasks["peg-insertion"]


def opened(answer: Answer) -> FakeSession:
    session = FakeSession(answer)
    session.open = True
    return session


def log_of(answer: Answer) -> list[EpisodeRecord]:
    session = opened(answer)
    env = FakeEnvironment()
    return [
        run_episode(env=env, task=TASK, episode=episode, open_session=lambda: session) for episode in TASK.episodes[:2]
    ]


def check(answer: Answer, records: list[EpisodeRecord]) -> Audit:
    return audit(env=FakeEnvironment(), task=TASK, records=records, open_session=partial(opened, answer))


def test_model_that_made_the_log_gives_all_its_actions() -> None:
    result = check(succeed, log_of(succeed))
    assert (result.actions, result.reproduced) == (6, 6)
    assert [episode.first_other for episode in result.episodes] == [None, None]


def test_other_model_is_told_by_its_first_other_action_and_compared_to_the_end() -> None:
    result = check(lambda _, step: action(0.25 if step == 2 else succeed(1, step)[0]), log_of(succeed))
    assert (result.actions, result.reproduced) == (6, 4)
    assert [episode.first_other for episode in result.episodes] == [2, 2]


def test_last_bit_counts() -> None:
    almost = np.nextafter(np.float32(0.5), np.float32(1))
    assert check(lambda _, step: action(almost if step < 3 else 1.0), log_of(succeed)).reproduced == 2


def test_model_that_fails_gives_what_it_gave_before() -> None:
    result = check(lambda _, step: fail() if step == 2 else action(0.5), log_of(succeed))
    assert result.reproduced == 2
    assert result.episodes[0].first_other == 2
    assert "crashed" in (result.episodes[0].failure or "")


def test_model_sees_what_the_logs_actions_lead_to() -> None:
    """The fake environment shows the number of env steps in `relative_motion`."""
    seen: list[float] = []

    class Watching(FakePolicy):
        def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
            seen.append(float(observation["relative_motion"][3]))
            return action(0.125)

    class WatchingSession(FakeSession):
        @contextmanager
        def episode(self, *, task: str, action_shape: tuple[int, ...]) -> Iterator[FakePolicy]:
            yield Watching(succeed, 1)

    audit(env=FakeEnvironment(), task=TASK, records=log_of(succeed)[:1], open_session=lambda: WatchingSession(succeed))
    assert seen == [0, 1, 2]


def test_model_that_cannot_be_loaded_is_refused() -> None:
    def cannot_load() -> FakeSession:
        raise PolicyFailed(VerdictCode.IMPORT_ERROR, "No module named 'torch'.")

    with pytest.raises(PolicyFailed):
        audit(env=FakeEnvironment(), task=TASK, records=log_of(succeed), open_session=cannot_load)


def actions_of(answer: Answer) -> dict[int, ActionSequence]:
    return {record.episode: record.actions for record in log_of(answer)}


def test_models_own_episodes_are_compared_up_to_the_first_other_action() -> None:
    log, other = actions_of(succeed), actions_of(lambda _, step: action(0.25 if step == 2 else succeed(1, step)[0]))
    assert [episode.first_other for episode in compare_actions(log, log).episodes] == [None, None]
    parted = compare_actions(log, {**log, 2: other[2]})
    assert [(episode.reproduced, episode.first_other) for episode in parted.episodes] == [(3, None), (1, 2)]


def test_episode_that_goes_on_or_is_missing_is_another() -> None:
    log = actions_of(succeed)
    longer = ActionSequence.from_array(np.vstack([log[1].to_array(), action(0.5)]))
    compared = compare_actions(log, {1: longer})
    assert [(episode.reproduced, episode.first_other) for episode in compared.episodes] == [(3, 4), (0, 1)]
