import numpy as np
from evaluation_fakes import FakeEnvironment, FakeSession, small_track, succeed
from vitac.evaluator.episodes.episode import run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.episodes.replay import resimulate

TASK = small_track().tasks["peg-insertion"]
START = TASK.episodes[0]


def actions(*xs: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    return np.array([[x, 0, 0] for x in xs], dtype=np.float32).reshape(len(xs), 3)


def test_recorded_actions_give_the_recorded_episode_again() -> None:
    session = FakeSession(succeed)
    session.open = True
    record = run_episode(env=FakeEnvironment(), task=TASK, episode=START, open_session=lambda: session)
    played = resimulate(FakeEnvironment(), START, record.actions.to_array())
    assert (played.state_hashes, played.infos) == (record.state_hashes, record.infos)
    assert (played.outcome, played.end_step, played.total_reward) == (record.outcome, 3, record.total_reward)
    assert (played.picture, record.picture) == (None, None)


def test_the_sampled_picture_is_the_recorded_one_and_never_of_an_env_step_after_the_end() -> None:
    session = FakeSession(succeed)
    session.open = True
    for start in TASK.episodes:
        record = run_episode(env=FakeEnvironment("rig"), task=TASK, episode=start, open_session=lambda: session)
        recorded = record.actions.to_array()
        further = resimulate(FakeEnvironment("rig"), start, np.concatenate([recorded, actions(*[0.25] * 20)]))
        assert record.picture is not None
        assert resimulate(FakeEnvironment("rig"), start, recorded).picture == further.picture == record.picture


def test_actions_after_the_end_are_played_and_change_neither_end_nor_reward() -> None:
    played = resimulate(FakeEnvironment(), START, actions(0.5, 1.0, 0.25, 1.0))
    assert (played.outcome, played.end_step, played.total_reward) == (EpisodeOutcome.SUCCESS, 2, 1.5)
    assert (len(played.infos), len(set(played.state_hashes))) == (4, 5)


def test_episode_that_nothing_ended_has_no_outcome() -> None:
    played = resimulate(FakeEnvironment(), START, actions(0.5, 0.5))
    assert (played.outcome, played.end_step) == (None, None)


def test_no_action_is_only_a_reset() -> None:
    played = resimulate(FakeEnvironment(), START, actions())
    assert (len(played.state_hashes), played.infos, played.outcome) == (1, (), None)
