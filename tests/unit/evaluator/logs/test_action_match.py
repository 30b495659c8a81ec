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
from vitac.evaluator.logs.comparison import ActionMatch, EpisodeMatch, compare_actions, match_actions

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


def check(answer: Answer, records: list[EpisodeRecord]) -> ActionMatch:
    return match_actions(env=FakeEnvironment(), task=TASK, records=records, open_session=partial(opened, answer))


def test_model_that_made_the_log_gives_all_its_actions() -> None:
    result = check(succeed, log_of(succeed))
    assert (result.actions, result.reproduced) == (6, 6)
    assert [episode.first_mismatch for episode in result.episodes] == [None, None]


def test_names_the_first_mismatch_and_compares_to_the_end() -> None:
    result = check(lambda _, step: action(0.25 if step == 2 else succeed(1, step)[0]), log_of(succeed))
    assert (result.actions, result.reproduced) == (6, 4)
    assert [episode.first_mismatch for episode in result.episodes] == [2, 2]


def test_last_bit_counts() -> None:
    almost = np.nextafter(np.float32(0.5), np.float32(1))
    assert check(lambda _, step: action(almost if step < 3 else 1.0), log_of(succeed)).reproduced == 2


def test_keeps_what_was_compared_before_a_failure() -> None:
    result = check(lambda _, step: fail() if step == 2 else action(0.5), log_of(succeed))
    assert result.reproduced == 2
    assert result.episodes[0].first_mismatch == 2
    assert "crashed" in (result.episodes[0].failure or "")


def test_model_gets_the_observations_of_the_logs_actions() -> None:
    """The fake environment shows the number of env steps in `relative_motion`."""
    seen: list[float] = []

    class Watching(FakePolicy):
        def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
            seen.append(float(observation["relative_motion"][3]))
            return action(0.125)

    class WatchingSession(FakeSession):
        @contextmanager
        def episode(self, *, task: str, action_shape: tuple[int, ...], clouds: object = ()) -> Iterator[FakePolicy]:
            yield Watching(succeed, 1)

    match_actions(
        env=FakeEnvironment(), task=TASK, records=log_of(succeed)[:1], open_session=lambda: WatchingSession(succeed)
    )
    assert seen == [0, 1, 2]


def test_model_that_cannot_be_loaded_is_refused() -> None:
    def cannot_load() -> FakeSession:
        raise PolicyFailed(VerdictCode.IMPORT_ERROR, "No module named 'torch'.")

    with pytest.raises(PolicyFailed):
        match_actions(env=FakeEnvironment(), task=TASK, records=log_of(succeed), open_session=cannot_load)


def actions_of(answer: Answer) -> dict[int, ActionSequence]:
    return {record.episode: record.actions for record in log_of(answer)}


def test_stored_actions_are_compared_up_to_the_first_mismatch() -> None:
    log, other = actions_of(succeed), actions_of(lambda _, step: action(0.25 if step == 2 else succeed(1, step)[0]))
    assert [episode.first_mismatch for episode in compare_actions(log, log).episodes] == [None, None]
    parted = compare_actions(log, {**log, 2: other[2]})
    assert [(episode.reproduced, episode.first_mismatch) for episode in parted.episodes] == [(3, None), (1, 2)]


def test_longer_or_missing_episode_is_a_mismatch() -> None:
    log = actions_of(succeed)
    longer = ActionSequence.from_array(np.vstack([log[1].to_array(), action(0.5)]))
    compared = compare_actions(log, {1: longer})
    assert [(episode.reproduced, episode.first_mismatch) for episode in compared.episodes] == [(3, 4), (0, 1)]
    shorter = compare_actions(log, {1: ActionSequence.from_array(log[1].to_array()[:2])})
    assert [(episode.reproduced, episode.first_mismatch) for episode in shorter.episodes] == [(2, 3), (0, 1)]


@pytest.mark.parametrize("value", [0.0, 0.25, 0.75])  # whose bytes are smaller or larger
def test_other_actions_do_not_count_whether_larger_or_smaller(value: float) -> None:
    log = log_of(lambda *_: action(0.5))
    assert check(lambda *_: action(value), log).reproduced == 0
    stored = {record.episode: record.actions for record in log}
    others = {n: ActionSequence.from_array(np.full_like(a.to_array(), value)) for n, a in stored.items()}
    assert compare_actions(stored, others).reproduced == 0


def test_each_episode_is_told_as_it_is_compared() -> None:
    told: list[EpisodeMatch] = []
    result = match_actions(
        env=FakeEnvironment(),
        task=TASK,
        records=log_of(succeed),
        open_session=partial(opened, succeed),
        on_episode=told.append,
    )
    assert tuple(told) == result.episodes
    assert len({episode.episode for episode in told}) == 2
