from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from evaluation_fakes import FakeEnvironment, FakeSession, action, cannot_load, fail, small_track, succeed
from evaluation_records import make_failure, make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.agent.verdicts import SandboxFailed, VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, FailureStage, result_hash
from vitac.evaluator.scoring.score import breaking_failure, is_broken
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.shards.policy import run_shard
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut

TRACK = small_track()
TASK = TRACK.tasks["peg-insertion"]
SHARDS = cut(TASK)


def run(load: Callable[..., Any], shard: int = 0, **options: Any) -> tuple[ShardResult, dict[int, EpisodeRecord]]:
    """Runs one shard of the small list; its result and its records by number."""
    records: list[EpisodeRecord] = []
    result = run_shard(
        submission_dir=Path("unused"),
        track=TRACK,
        task=TASK,
        shard=SHARDS[shard],
        on_episode=records.append,
        load_policy=load,
        make_env=lambda *_: FakeEnvironment(),
        **options,
    )
    assert len({record.episode for record in records}) == len(records)
    return result, {record.episode: record for record in records}


def test_official_list_is_cut_into_nine_shards_of_thirty() -> None:
    shards = cut(load_track("track_1").tasks["peg-insertion"])
    assert [len(shard.episodes) for shard in shards] == [27] * 10
    assert [number for shard in shards for number in sorted(shard.numbers)] == list(range(1, 271))


@pytest.mark.parametrize(("failures", "broken"), [(0, False), (1, False), (2, False), (3, True), (4, True)])
def test_three_failures_in_a_shard_break_a_policy_and_so_do_more(failures: int, broken: bool) -> None:
    assert is_broken([make_failure()] * failures) is broken


@pytest.mark.parametrize("code", VerdictCode)
def test_one_failure_breaks_a_policy_only_where_the_shard_has_no_time_left(code: VerdictCode) -> None:
    assert is_broken([make_failure(code=code)]) is (code.value == "shard_time")


@given(st.sets(st.integers(1, 12), min_size=1))
def test_part_of_a_list_is_cut_at_the_same_places(numbers: set[int]) -> None:
    shards = cut(TASK, numbers)
    assert set().union(*(shard.numbers for shard in shards)) == numbers
    for shard in shards:
        assert shard.numbers == SHARDS[shard.index].numbers & numbers


def test_shard_plays_each_of_its_episodes_with_one_load() -> None:
    session = FakeSession(succeed)
    result, records = run(session.load, shard=1)
    assert (result.index, result.end) == (1, ShardEnd.COMPLETE)
    assert sorted(records) == [5, 6, 7, 8]
    assert all(record.success for record in records.values())
    assert (session.loads, session.open) == (1, False)


def test_manifest_names_what_the_shard_was_made_with() -> None:
    manifest = run(FakeSession(succeed).load)[0].manifest
    assert (manifest.track, manifest.task, manifest.list_seed) == ("track_1", "peg-insertion", 0)
    assert (manifest.solver_version, manifest.mesh_hash, manifest.task_hash) == ("fake", "0" * 64, TASK.digest())


def test_isolation_is_recorded_where_a_policy_was_loaded() -> None:
    session = FakeSession(succeed)
    assert run(session.load)[0].isolation == session.isolation
    assert run(cannot_load)[0].isolation is None


def test_resumed_shard_plays_only_what_is_missing_and_ends_with_the_same_hash() -> None:
    result, whole = run(FakeSession(succeed).load)
    _, rest = run(FakeSession(succeed).load, skip={1, 4})
    assert sorted(rest) == [2, 3]
    resumed = [whole[1], whole[4], *rest.values()]
    assert result_hash(result.manifest, resumed) == result_hash(result.manifest, whole.values())


def test_nothing_is_loaded_where_nothing_is_missing() -> None:
    session = FakeSession(succeed)
    result, records = run(session.load, skip={1, 2, 3, 4})
    assert (result.end, records, session.loads) == (ShardEnd.COMPLETE, {}, 0)


def test_single_failure_costs_only_its_episode() -> None:
    result, records = run(FakeSession(lambda episode, step: fail() if episode == 2 else succeed(1, step)).load)
    assert result.end is ShardEnd.COMPLETE
    assert sorted(record.outcome for record in records.values()) == ["policy_failed", "success", "success", "success"]
    assert breaking_failure(SHARDS, records.values()) is None


def test_third_failure_ends_the_shard() -> None:
    result, records = run(FakeSession(fail).load)
    assert result.end is ShardEnd.BROKEN
    assert len(records) == 3
    failure = breaking_failure(SHARDS, records.values())
    assert failure is not None
    assert failure.code is VerdictCode.CRASHED


def test_policy_that_cannot_be_loaded_ends_the_shard_at_once() -> None:
    result, records = run(cannot_load)
    assert result.end is ShardEnd.BROKEN
    assert [record.failure.stage for record in records.values() if record.failure] == [FailureStage.LOAD]


def test_failures_before_a_resume_count() -> None:
    result, records = run(FakeSession(fail).load, skip={1, 2}, failures=[make_failure(), make_failure()])
    assert (result.end, len(records)) == (ShardEnd.BROKEN, 1)


def test_shard_that_was_broken_stays_broken() -> None:
    session = FakeSession(succeed)
    result, records = run(session.load, skip={1}, failures=[make_failure(stage=FailureStage.LOAD)])
    assert (result.end, records, session.loads) == (ShardEnd.BROKEN, {}, 0)


def test_fault_of_the_sandbox_is_not_the_teams() -> None:
    def broken(*_: object) -> Any:
        raise SandboxFailed("bwrap is missing")

    with pytest.raises(SandboxFailed):
        run(broken)


def test_order_is_not_the_lists() -> None:
    """In one of 24 orders each; 40 runs give the list's order every time with a chance below 1e-50."""
    orders = set()
    for _ in range(40):
        played: list[int] = []
        run_shard(
            submission_dir=Path("unused"),
            track=TRACK,
            task=TASK,
            shard=SHARDS[0],
            on_episode=lambda record, played=played: played.append(record.episode),  # type: ignore[misc]
            load_policy=FakeSession(succeed).load,
            make_env=lambda *_: FakeEnvironment(),
        )
        orders.add(tuple(played))
    assert len(orders) > 1
    assert orders <= set(permutations([1, 2, 3, 4]))


@given(
    st.lists(st.sampled_from([None, FailureStage.EPISODE, FailureStage.LOAD]), min_size=12, max_size=12),
    st.randoms(),
)
def test_verdict_is_of_the_first_broken_shard_in_any_order(stages: list[FailureStage | None], shuffler: Any) -> None:
    records = [
        make_record(number, EpisodeOutcome.POLICY_FAILED, failure=make_failure(stage=stage, message=str(number)))
        if stage
        else make_record(number)
        for number, stage in enumerate(stages, start=1)
    ]
    expected = None
    for shard in SHARDS:
        failures = [record.failure for record in records if record.episode in shard.numbers and record.failure]
        if expected is None and is_broken(failures):
            at_once = [failure for failure in failures if failure.stage is FailureStage.LOAD]
            expected = (at_once or failures)[0]
    shuffler.shuffle(records)
    assert breaking_failure(SHARDS, records) == expected


def test_time_of_the_shard_that_is_used_up_ends_it_at_once_and_is_the_verdict() -> None:
    failures = {1: make_failure(), 3: make_failure(code=VerdictCode.SHARD_TIME)}
    result, records = run(FakeSession(succeed).load, skip=set(failures), failures=list(failures.values()))
    assert (result.end, records) == (ShardEnd.BROKEN, {})
    failed = [
        make_record(number, EpisodeOutcome.POLICY_FAILED, failure=failure) for number, failure in failures.items()
    ]
    assert breaking_failure(SHARDS, failed) == failures[3]


def test_actions_reach_the_record_unclipped() -> None:
    _, records = run(FakeSession(lambda *_: action(7.5)).load)
    assert records[1].actions.to_array().max() == 7.5
