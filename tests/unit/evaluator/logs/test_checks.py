import numpy as np
import pytest
from evaluation_records import make_record
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.logs.checks import out_of_bounds, why_record_impossible
from vitac.evaluator.logs.findings import ImpossibleReason
from vitac.evaluator.tracks import load_track

TASK = load_track("track_1").tasks["peg-insertion"]
FIRST = TASK.episodes[0]


def record_of(env_steps: int) -> EpisodeRecord:
    """Episode 1 of the list, as long as that."""
    return make_record(1, env_steps=env_steps, shape=FIRST.shape, initial_offset=FIRST.offset)


def test_an_episode_may_use_all_its_env_steps() -> None:
    assert why_record_impossible(TASK, record_of(TASK.max_steps)) is None


def test_one_env_step_too_many_is_impossible() -> None:
    problem = why_record_impossible(TASK, record_of(TASK.max_steps + 1))
    assert problem is not None
    assert (problem.reason, problem.episode) == (ImpossibleReason.TOO_MANY_STEPS, 1)
    assert f"{TASK.max_steps + 1}" in problem.message


def test_the_last_episode_of_the_list_is_possible_and_the_one_after_it_is_not() -> None:
    last = TASK.episodes[-1]
    whole = make_record(last.number, shape=last.shape, initial_offset=last.offset)
    assert why_record_impossible(TASK, whole) is None
    problem = why_record_impossible(TASK, whole.model_copy(update={"episode": last.number + 1}))
    assert problem is not None
    assert problem.reason is ImpossibleReason.NOT_IN_LIST


@pytest.mark.parametrize("task", ["a-task-before-ours", "zz-task-after-ours"])
def test_a_record_of_another_task_is_impossible(task: str) -> None:
    problem = why_record_impossible(TASK, record_of(2).model_copy(update={"task": task}))
    assert problem is not None
    assert problem.reason is ImpossibleReason.OTHER_TASK


def test_the_first_action_outside_is_named() -> None:
    actions = np.zeros((4, 3), np.float32)
    actions[1, 0], actions[2, 1] = 2, -2
    assert f"{TASK.actions[0].name} = 2 at env step 2" in (out_of_bounds(TASK, actions) or "")


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_actions_may_reach_their_bounds(value: float) -> None:
    actions = ActionSequence.from_array(np.full((2, 3), value, np.float32))
    assert why_record_impossible(TASK, record_of(2).model_copy(update={"actions": actions})) is None


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_the_next_number_beyond_a_bound_is_outside(value: float) -> None:
    actions = np.zeros((2, 3), np.float32)
    actions[1, 2] = np.nextafter(np.float32(value), np.float32(2 * value))
    assert "env step 2" in (out_of_bounds(TASK, actions) or "")
