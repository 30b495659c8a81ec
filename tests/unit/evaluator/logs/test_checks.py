from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from evaluation_records import make_failure, make_manifest, make_record
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.logs.checks import (
    explain_impossible,
    explain_impossible_record,
    known_without_running,
    must_agree,
    out_of_bounds,
)
from vitac.evaluator.logs.findings import Impossibility, ImpossibleReason
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.tracks import load_track
from vitac.evaluator.version import evaluator_parts, evaluator_version

TASK = load_track("track_1").tasks["peg-insertion"]
FIRST = TASK.episodes[0]


def record_of(env_steps: int) -> EpisodeRecord:
    """Episode 1 of the list, as long as that."""
    return make_record(1, env_steps=env_steps, shape=FIRST.shape, initial_offset=FIRST.offset)


def test_an_episode_may_use_all_its_env_steps() -> None:
    assert explain_impossible_record(TASK, record_of(TASK.max_steps)) is None


def test_the_last_episode_of_the_list_is_possible_and_the_one_after_it_is_not() -> None:
    last = TASK.episodes[-1]
    whole = make_record(last.number, shape=last.shape, initial_offset=last.offset)
    assert explain_impossible_record(TASK, whole) is None
    problem = explain_impossible_record(TASK, whole.model_copy(update={"episode": last.number + 1}))
    assert problem is not None
    assert problem.reason is ImpossibleReason.NOT_IN_LIST


@pytest.mark.parametrize("task", ["a-task-before-ours", "zz-task-after-ours"])
def test_a_record_of_another_task_is_impossible(task: str) -> None:
    problem = explain_impossible_record(TASK, record_of(2).model_copy(update={"task": task}))
    assert problem is not None
    assert problem.reason is ImpossibleReason.OTHER_TASK


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_actions_may_reach_their_bounds(value: float) -> None:
    actions = ActionSequence.from_array(np.full((2, 3), value, np.float32))
    assert explain_impossible_record(TASK, record_of(2).model_copy(update={"actions": actions})) is None


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_the_next_number_beyond_a_bound_is_outside(value: float) -> None:
    actions = np.zeros((2, 3), np.float32)
    actions[1, 2] = np.nextafter(np.float32(value), np.float32(2 * value))
    assert "env step 2" in (out_of_bounds(TASK, actions) or "")


def listed(number: int, **changes: Any) -> EpisodeRecord:
    start = TASK.episodes[number - 1]
    return make_record(number, **{"shape": start.shape, "initial_offset": start.offset, **changes})


def crashed(number: int) -> EpisodeRecord:
    return listed(number, outcome=EpisodeOutcome.POLICY_FAILED, env_steps=0, failure=make_failure())


def problem_of(*records: EpisodeRecord, episodes: set[int] | None = None, **manifest: Any) -> Impossibility | None:
    """Why a log with these records and changes of its manifest is impossible."""
    header = LogHeader(manifest=make_manifest(**manifest))
    wanted = {record.episode for record in records} if episodes is None else episodes
    return explain_impossible(must_agree(make_manifest()), TASK, header, records, wanted)


def test_a_log_of_our_own_evaluation_is_possible() -> None:
    assert problem_of(listed(1), listed(2)) is None


@pytest.mark.parametrize(
    "key", ["track", "task", "list_seed", "task_hash", "evaluator_version", "solver_version", "mesh_hash"]
)
def test_a_log_of_another_evaluation_is_impossible_and_the_difference_named(key: str) -> None:
    other: Any = 7 if key == "list_seed" else "other"
    problem = problem_of(listed(1), **{key: other})
    assert problem is not None
    assert (problem.reason, problem.episode) == (ImpossibleReason.OTHER_EVALUATION, None)
    ours = getattr(make_manifest(), key)
    assert problem.message == f"Expected a log made with {key} {ours!r}, got {other!r}; evaluate again."


@pytest.mark.parametrize("key", ["evaluator_hash", "platform_class"])
def test_a_log_may_come_from_another_machine(key: str) -> None:
    changes: dict[str, Any] = {key: "other"}
    assert problem_of(listed(1), **changes) is None


def test_what_is_not_known_yet_is_not_compared() -> None:
    header = LogHeader(manifest=make_manifest(mesh_hash="other"))
    assert explain_impossible({"task": "peg-insertion"}, TASK, header, [listed(1)], {1}) is None


def test_missing_episodes_are_counted_and_the_first_is_named() -> None:
    problem = problem_of(listed(1), listed(4), episodes={1, 2, 3, 4, 5})
    assert problem is not None
    assert (problem.reason, problem.episode) == (ImpossibleReason.EPISODE_MISSING, 2)
    assert problem.message == "Expected 5 episodes, got 2; the first missing one is 2."


def test_the_whole_list_is_required_by_default() -> None:
    header = LogHeader(manifest=make_manifest())
    problem = explain_impossible(must_agree(make_manifest()), TASK, header, [listed(1)])
    assert problem is not None
    assert problem.message == f"Expected {len(TASK.episodes)} episodes, got 1; the first missing one is 2."


def test_episodes_beyond_the_required_ones_are_allowed() -> None:
    assert problem_of(listed(1), listed(2), episodes={2}) is None


def test_the_first_impossible_record_goes_before_what_is_missing() -> None:
    problem = problem_of(listed(1), listed(2, shape="sphere"), episodes={1, 2, 3})
    assert problem is not None
    assert (problem.reason, problem.episode) == (ImpossibleReason.OTHER_START, 2)


def test_single_failures_in_several_shards_are_possible() -> None:
    size = TASK.shard_size
    assert problem_of(crashed(1), crashed(2), crashed(size + 1), crashed(size + 2)) is None


def test_a_policy_that_failed_too_often_is_named_by_the_first_failure_of_its_shard() -> None:
    """A failure of an earlier shard may say just the same."""
    size = TASK.shard_size
    problem = problem_of(crashed(1), *(crashed(size + number) for number in (3, 4, 5)))
    assert problem is not None
    assert (problem.reason, problem.episode) == (ImpossibleReason.BROKEN_POLICY, size + 3)
    assert problem.message == (
        f"The policy failed too often, starting at episode {size + 3}; such an evaluation ends without a score."
    )


def test_what_is_known_without_an_environment_is_a_part_of_what_must_agree() -> None:
    track = load_track("track_1")
    known = known_without_running(track, TASK)
    assert known == {
        "track": "track_1",
        "task": "peg-insertion",
        "list_seed": TASK.episode_list.list_seed,
        "task_hash": TASK.digest(),
        "evaluator_version": evaluator_version(),
        "evaluator_parts": evaluator_parts(),
    }
    assert known.keys() < must_agree(make_manifest()).keys()


def test_a_log_of_another_evaluator_is_refused_with_the_parts_that_differ() -> None:
    ours = make_manifest().model_copy(update={"evaluator_parts": {"numpy": "2.4.6", "vitac.envs": "a"}})
    theirs = ours.model_copy(
        update={"evaluator_version": "1+b", "evaluator_parts": {"numpy": "2.5.0", "vitac.envs": "a"}}
    )
    problem = explain_impossible(must_agree(ours), TASK, LogHeader(manifest=theirs), [])
    assert problem is not None
    assert problem.message.endswith("got '1+b' (they differ in numpy); evaluate again.")


def test_what_must_agree_leaves_out_what_only_names_the_machine() -> None:
    manifest = make_manifest()
    assert must_agree(manifest) == manifest.model_dump(exclude={"evaluator_hash", "platform_class"})


START = f"{FIRST.shape} at {FIRST.offset}"
LAST = TASK.episodes[-1].number


@pytest.mark.parametrize(
    ("changes", "reason", "message"),
    [
        (
            {"env_steps": TASK.max_steps + 1},
            ImpossibleReason.TOO_MANY_STEPS,
            f"Episode 1 has {TASK.max_steps + 1} env steps, expected at most {TASK.max_steps}.",
        ),
        (
            {"task": "lock-opening"},
            ImpossibleReason.OTHER_TASK,
            "Episode 1 is of task 'lock-opening', expected 'peg-insertion'.",
        ),
        (
            {"episode": LAST + 1},
            ImpossibleReason.NOT_IN_LIST,
            f"Episode {LAST + 1} is not in the list of {LAST} episodes.",
        ),
        (
            {"shape": "sphere"},
            ImpossibleReason.OTHER_START,
            f"Episode 1: expected the start {START}, got sphere at {FIRST.offset}.",
        ),
        (
            {"initial_offset": (0.0, 0.0, 0.0)},
            ImpossibleReason.OTHER_START,
            f"Episode 1: expected the start {START}, got {FIRST.shape} at (0.0, 0.0, 0.0).",
        ),
        (
            {"actions": ActionSequence.from_array(np.zeros((2, 4), np.float32))},
            ImpossibleReason.WRONG_ACTION,
            "Episode 1: expected actions [x, y, theta] in the range of float32.",
        ),
        (
            {"actions": ActionSequence.from_array(np.array([[0, 0, 0], [0, 0, -2.5]], np.float32))},
            ImpossibleReason.WRONG_ACTION,
            "Episode 1 has the action theta = -2.5 at env step 2, expected values in [-1, 1].",
        ),
    ],
)
def test_an_impossible_record_is_told_in_one_sentence(
    changes: dict[str, Any], reason: ImpossibleReason, message: str
) -> None:
    problem = explain_impossible_record(TASK, record_of(2).model_copy(update=changes))
    assert problem is not None
    assert (problem.reason, problem.message, problem.episode) == (reason, message, changes.get("episode", 1))


def test_episodes_that_were_played_well_do_not_count_as_failures() -> None:
    assert problem_of(*(listed(number) for number in range(1, 9)), crashed(9), crashed(10)) is None


def test_missing_episodes_go_before_a_broken_policy() -> None:
    problem = problem_of(crashed(2), crashed(3), crashed(4), episodes={1, 2, 3, 4})
    assert problem is not None
    assert problem.reason is ImpossibleReason.EPISODE_MISSING


def test_records_are_read_one_at_a_time_up_to_the_first_impossible_one() -> None:
    def records() -> Iterator[EpisodeRecord]:
        yield listed(1)
        yield listed(2, shape="sphere")
        raise AssertionError("a record after the impossible one was read")

    header = LogHeader(manifest=make_manifest())
    problem = explain_impossible(must_agree(make_manifest()), TASK, header, records())
    assert problem is not None
    assert problem.episode == 2


@pytest.mark.parametrize("shape", [(0, 3), (1, 3), (5, 3)])
def test_actions_inside_are_no_problem_however_many(shape: tuple[int, int]) -> None:
    assert out_of_bounds(TASK, np.full(shape, -1, np.float32)) is None


def test_of_several_values_outside_the_earliest_env_step_and_then_the_first_component_is_named() -> None:
    actions = np.zeros((3, 3), np.float32)
    actions[2, 0] = actions[1, 2] = 7
    actions[1, 1] = -3
    assert out_of_bounds(TASK, actions) == "has the action y = -3 at env step 2, expected values in [-1, 1]."
