from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from evaluation_fakes import Answer, FakeEnvironment, FakePolicy, FakeSession, action, fail, small_track, succeed
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.episode import EnvironmentBroken, json_info, resimulate, run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, FailureStage, Timings
from vitac.evaluator.tracks.definition import WhileThinking

TASK = small_track().tasks["peg-insertion"]


def play(answer: Answer = succeed, env: FakeEnvironment | None = None, number: int = 1) -> EpisodeRecord:
    session = FakeSession(answer)
    session.open = True
    episode = TASK.episodes[number - 1]
    return run_episode(env=env or FakeEnvironment(), task=TASK, episode=episode, open_session=lambda: session)


def test_record_holds_what_happened() -> None:
    record = play()
    assert (record.episode, record.task, record.shape, record.initial_offset) == (
        1, "peg-insertion", "cuboid", (-4, -4, -8),
    )  # fmt: skip
    assert (record.outcome, record.success, record.env_steps) == (EpisodeOutcome.SUCCESS, True, 3)
    assert record.actions.to_array().tolist() == [[0.5, 0, 0], [0.5, 0, 0], [1, 0, 0]]
    assert record.total_reward == 2.0
    assert len(set(record.state_hashes)) == 4
    assert record.infos[2] == {
        "steps": 3, "surface_diff_m": [0.001, 0.002], "is_success": True, "end_reason": "success",
    }  # fmt: skip


def test_time_is_split_by_what_used_it() -> None:
    timings = play().timings
    assert timings.model_copy(update={"wall_s": 0.0}) == Timings(
        physics_s=1.75, markers_s=0.375, policy_s=0.0625, channel_s=0.03125
    )
    assert timings.wall_s > 0


def test_episode_without_success_ends_with_the_environments_reason() -> None:
    record = play(lambda *_: action(0.25))
    assert (record.outcome, record.env_steps) == (EpisodeOutcome.STEPS, 8)


def test_same_actions_give_the_same_record_in_a_used_environment() -> None:
    env = FakeEnvironment()
    play(env=env, number=2)
    assert play(env=env).record_digest() == play().record_digest()


def test_failing_policy_is_recorded_with_verdict_and_output() -> None:
    record = play(lambda episode, step: fail() if step == 3 else action(0.5))
    assert (record.outcome, record.env_steps, record.success) == (EpisodeOutcome.POLICY_FAILED, 2, False)
    assert record.failure is not None
    assert (record.failure.stage, record.failure.code) == (FailureStage.EPISODE, VerdictCode.CRASHED)
    assert record.failure.output_tail == "Segmentation fault"
    assert record.timings.policy_s == 0.0625


def test_output_of_a_policy_that_plays_well_is_kept() -> None:
    record = play(lambda *_: action(1.0))
    assert (record.outcome, record.output) == (EpisodeOutcome.SUCCESS, "I am thinking.\n")


def test_policy_that_cannot_be_loaded_is_recorded_as_such() -> None:
    def open_session() -> FakeSession:
        raise PolicyFailed(VerdictCode.IMPORT_ERROR, "No module named 'torch'.")

    record = run_episode(env=FakeEnvironment(), task=TASK, episode=TASK.episodes[0], open_session=open_session)
    assert record.failure is not None
    assert (record.failure.stage, record.env_steps, len(record.state_hashes)) == (FailureStage.LOAD, 0, 1)


def test_failure_after_the_last_action_does_not_undo_the_episode() -> None:
    class FailsAtTheEnd(FakeSession):
        @contextmanager
        def episode(self, *, task: str, action_shape: tuple[int, ...], clouds: object = ()) -> Iterator[FakePolicy]:
            yield FakePolicy(succeed, 1)
            fail()

    record = run_episode(
        env=FakeEnvironment(), task=TASK, episode=TASK.episodes[0], open_session=lambda: FailsAtTheEnd(succeed)
    )
    assert record.outcome is EpisodeOutcome.SUCCESS
    assert record.failure is None


def test_recorded_actions_are_copies() -> None:
    reused = np.zeros(3, dtype=np.float32)

    def answer(_: int, step: int) -> Any:
        reused[0] = 1.0 if step == 2 else 0.25
        return reused

    assert play(answer).actions.to_array()[:, 0].tolist() == [0.25, 1.0]


def test_privileged_key_never_reaches_a_policy() -> None:
    env = FakeEnvironment()
    env.extra_observation = {"gt_offset": np.zeros(3, np.float32)}

    def never_asked(*_: object) -> Any:
        raise AssertionError("the policy was asked")

    with pytest.raises(EnvironmentBroken, match="gt_offset"):
        play(never_asked, env)


def test_environment_that_does_not_end_is_a_fault_of_ours() -> None:
    env = FakeEnvironment()
    env.endless = True
    with pytest.raises(EnvironmentBroken, match="did not end within 8 env steps"):
        play(env=env)


def test_info_that_is_no_json_is_refused() -> None:
    with pytest.raises(EnvironmentBroken, match=r"info\['pose'\] is a object"):
        json_info({"pose": object()})


def play_late(delay_steps: int, while_thinking: str) -> list[float]:
    """What was done in each env step with a policy whose n-th answer is n tenths."""
    session = FakeSession(lambda _, step: action(step / 10))
    session.open = True
    task = TASK.model_copy(update={"delay_steps": delay_steps, "while_thinking": WhileThinking(while_thinking)})
    record = run_episode(env=FakeEnvironment(), task=task, episode=task.episodes[0], open_session=lambda: session)
    return list(map(float, record.actions.to_array()[:, 0]))


@pytest.mark.parametrize(
    ("delay_steps", "while_thinking", "expected"),
    [
        (0, "stop", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]),
        (1, "stop", [0, 0.1, 0, 0.2, 0, 0.3, 0, 0.4]),
        (2, "stop", [0, 0, 0.1, 0, 0, 0.2, 0, 0]),
        (2, "hold", [0, 0, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2]),
    ],
)
def test_an_answer_is_played_after_the_delay_of_its_task(
    delay_steps: int, while_thinking: str, expected: list[float]
) -> None:
    assert play_late(delay_steps, while_thinking) == pytest.approx(expected)


def test_a_task_without_delay_keeps_its_digest_and_each_delay_has_another() -> None:
    digests = {TASK.model_copy(update={"delay_steps": steps}).digest() for steps in (0, 1, 2)}
    held = TASK.model_copy(update={"delay_steps": 1, "while_thinking": WhileThinking.HOLD})
    assert len(digests | {held.digest()}) == 4
    assert TASK.model_copy(update={"while_thinking": WhileThinking.HOLD}).digest() == TASK.digest()


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
