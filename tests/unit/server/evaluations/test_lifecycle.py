from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor

import pytest
from service_factories import (
    LOCK,
    TASK,
    claim,
    finish,
    make_failed_record,
    make_manifest,
    make_principal,
    make_record,
    make_settings,
    play,
    play_all,
    shard_ids,
    state_of,
    store,
    submit,
    take_away,
)
from sqlalchemy import select, text
from submission_steps import ids_of
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, FailureStage, result_hash
from vitac.evaluator.package_sets import digest_of_packages
from vitac.evaluator.scoring.score import score
from vitac.evaluator.shards.order import ShardEnd
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Submission
from vitac.server.database.states import EvaluationState, WorkState
from vitac.server.evaluations.episode_store import EpisodeKey, read_stored_records, store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import EpisodesMissing
from vitac.server.evaluations.scores import combine_hashes, combined_score, read_scores
from vitac.server.evaluations.view import show_evaluation
from vitac.server.queue.leases import Lease
from vitac.server.queue.work import LeaseLost, count_open, lock_held, name_requirement
from vitac.server.submissions import listing, runs
from worker_fakes import eventually


def outcome_of(episode: int) -> EpisodeOutcome:
    return EpisodeOutcome.SUCCESS if episode % 3 == 0 else EpisodeOutcome.STEPS


def some_record(episode: int, *, task: str = TASK) -> EpisodeRecord:
    return make_record(episode, outcome_of(episode), task)


def test_a_new_evaluation_has_the_fixed_shards_which_wait(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        shards = newest_evaluation(session, submission).shards
        assert [len(shard.episodes) for shard in shards] == [27] * 10
        assert sorted(episode for shard in shards for episode in shard.episodes) == list(range(1, 271))
        assert {(shard.state, shard.requires) for shard in shards} == {
            (WorkState.QUEUED, name_requirement(evaluator_version()))
        }


def test_work_vanishes_with_a_transaction_that_is_rolled_back(database: Database) -> None:
    with database.transaction() as session:
        submit(session, make_principal(session))
        session.rollback()
    with database.transaction() as session:
        assert count_open(session) == 0
        assert session.scalar(text("SELECT count(*) FROM submissions")) == 0


def test_last_shard_scores_the_evaluation_with_the_evaluators_own_functions(
    database: Database, submission: Submission
) -> None:
    ids = ids_of(database, submission)
    for shard_id in (*ids[5:], *ids[:5]):
        with database.transaction() as session:
            assert newest_evaluation(session, submission).state is not EvaluationState.COMPLETED
        play(database, shard_id, some_record)
    records = [some_record(episode) for episode in range(1, 271)]
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.COMPLETED
        assert read_scores(evaluation) == {TASK: score(records)}
        combined = combined_score(evaluation)
        assert combined is not None
        assert combined.success_rate == score(records).success_rate / 2  # of the track's two tasks
        assert combined.mean_steps is None
        assert evaluation.result_hash == result_hash(make_manifest(), records)
        assert evaluation.scores is not None
        assert evaluation.scores[0]["task"] == TASK
        assert evaluation.scores[0]["outcomes"] == {"steps": 180, "success": 90}


def test_shard_that_lacks_an_episode_cannot_be_reported_as_complete(database: Database, submission: Submission) -> None:
    first = ids_of(database, submission)[0]
    lease = claim(database, first)
    store(database, lease, [make_record(episode) for episode in lease.episodes[:-1]])
    with pytest.raises(EpisodesMissing, match=r"\[27\]"):
        finish(database, lease)
    with database.transaction() as session:
        assert state_of(session, first) is WorkState.RUNNING


def test_broken_policy_fails_the_evaluation_with_the_first_failure_whatever_the_order(
    database: Database, submission: Submission
) -> None:
    ids = ids_of(database, submission)
    early, late = claim(database, ids[0]), claim(database, ids[4])
    store(database, late, [make_failed_record(109, stage=FailureStage.LOAD, code=VerdictCode.IMPORT_ERROR)])
    finish(database, late, ShardEnd.BROKEN)
    with database.transaction() as session:
        # Later shards end, earlier ones may still change the verdict.
        assert [state_of(session, shard_id) for shard_id in ids[5:]] == [WorkState.CANCELLED] * 5
        assert newest_evaluation(session, submission).state is EvaluationState.RUNNING
        assert count_open(session) == 4
    store(database, early, [make_failed_record(episode, output=f"out {episode}") for episode in (7, 3, 9)])
    finish(database, early, ShardEnd.BROKEN)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.FAILED
        assert (evaluation.verdict_code, evaluation.verdict_task, evaluation.verdict_episode) == ("crashed", TASK, 3)
        assert evaluation.log_tail == "out 3"
        assert evaluation.result_hash is None


def test_two_tasks_are_scored_each_and_together(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session), tasks=(TASK, LOCK))
        shards = newest_evaluation(session, submission).shards
        assert [len(shard.episodes) for shard in shards] == [27] * 10 + [20] * 8
    play_all(database, submission, lambda n, task: make_record(n, task=task) if task == LOCK else some_record(n))
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        scores = read_scores(evaluation)
        assert [(task, score.episodes, score.successes) for task, score in scores.items()] == [
            (TASK, 270, 90),
            (LOCK, 160, 160),
        ]
        combined = combined_score(evaluation)
        assert combined is not None
        assert combined.success_rate == pytest.approx((1 / 3 + 1) / 2)
        assert combined.mean_steps == 3.0
        hashes = {row["task"]: row["result_hash"] for row in evaluation.scores or []}
        expected = [make_record(episode, task=LOCK) for episode in range(1, 161)]
        assert hashes[LOCK] == result_hash(make_manifest(LOCK), expected)
        assert evaluation.result_hash == combine_hashes(hashes) != hashes[TASK]


def test_a_policy_that_is_broken_in_one_task_fails_with_that_task_named(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session), tasks=(TASK, LOCK))
        ids = shard_ids(session, submission)
    lease = claim(database, ids[10])
    store(database, lease, [make_failed_record(episode, task=LOCK) for episode in (1, 2, 3)])
    finish(database, lease, ShardEnd.BROKEN)
    for shard_id in ids[:10]:
        play(database, shard_id)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert (evaluation.verdict_code, evaluation.verdict_task, evaluation.verdict_episode) == ("crashed", LOCK, 1)


def test_a_few_policy_failures_are_unsuccessful_episodes_of_a_completed_evaluation(
    database: Database, submission: Submission
) -> None:
    play_all(database, submission, lambda n, task: make_failed_record(n) if n in (5, 100) else make_record(n))
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.COMPLETED
        assert read_scores(evaluation)[TASK].successes == 268
        assert "[peg-insertion, episode 5: crashed]" in evaluation.log_tail


def test_output_that_the_database_cannot_hold_is_stored_all_the_same(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    lease = claim(database, first)
    store(database, lease, [make_failed_record(n, output="nul \0 and half \ud800 a pair") for n in (1, 2, 3)])
    finish(database, lease, ShardEnd.BROKEN)
    with database.transaction() as session:
        view = newest_evaluation(session, submission)
        assert view.state is EvaluationState.FAILED
        assert view.log_tail == "nul \N{REPLACEMENT CHARACTER} and half ? a pair"


def test_cancel_ends_the_evaluation_and_fences_off_its_workers(database: Database) -> None:
    with database.transaction() as session:
        principal = make_principal(session)
        submission = submit(session, principal)
        ids = shard_ids(session, submission)
    play(database, ids[0])
    lease = claim(database, ids[1])
    with database.transaction() as session:
        runs.cancel(session, principal, submission.id)
    with pytest.raises(LeaseLost):
        store(database, lease, [make_record(lease.episodes[0])])
    with pytest.raises(LeaseLost):
        finish(database, lease)
    with database.transaction() as session:
        assert newest_evaluation(session, submission).state is EvaluationState.CANCELLED
        assert [state_of(session, shard_id) for shard_id in ids] == [WorkState.DONE] + [WorkState.CANCELLED] * 9
        assert count_open(session) == 0
        assert len(session.scalars(select(EpisodeResult)).all()) == 27


def test_evaluation_of_a_second_run_has_records_of_its_own(database: Database) -> None:
    with database.transaction() as session:
        principal = make_principal(session)
        submission = submit(session, principal)
    play_all(database, submission)
    with database.transaction() as session:
        submit(session, principal, again=True)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert (evaluation.run, evaluation.episodes_reused) == (2, 0)
    play_all(database, submission)
    with database.transaction() as session:
        hashes = {
            entry.result_hash for entry in listing.get(session, make_settings(), principal, submission.id).evaluations
        }
        assert len(hashes) == 1
        assert len(session.scalars(select(EpisodeResult)).all()) == 540


def test_records_are_read_back_as_they_were_written(database: Database, submission: Submission) -> None:
    play_all(database, submission, some_record)
    with database.transaction() as session:
        key = EpisodeKey.from_evaluation(newest_evaluation(session, submission), submission)
        read = read_stored_records(session, key, TASK)
    assert read == [some_record(episode) for episode in range(1, 271)]


def test_a_result_keeps_which_packages_its_policy_saw_in_each_shard(database: Database) -> None:
    """Also where a worker was stopped, or killed before it said that its shard is done."""
    first, second, third = kinds = [{"numpy": "2.5.0", "torch": "2.13.0"}, {"numpy": "2.5.0"}, {"numpy": "2.4.0"}]
    with database.transaction() as session:
        principal = make_principal(session)
        submission = submit(session, principal)
        ids = shard_ids(session, submission)

    def kept() -> list[dict[str, str]]:
        with database.transaction() as session:
            return newest_evaluation(session, submission).packages

    lease = claim(database, ids[0])
    assert kept() == [], "it has stored nothing"
    store_all(database, lease, lease.episodes[:2], first)
    take_away(database, ids[0])
    lease = claim(database, ids[0])
    store_all(database, lease, lease.episodes[2:], second)
    finish(database, lease)
    assert kept() == [first, second]

    lease = claim(database, ids[1])
    store_all(database, lease, lease.episodes, third)
    take_away(database, ids[1])
    with pytest.raises(LeaseLost):
        store_all(database, lease, lease.episodes[:1], {"numpy": "2.3.0"})
    finish(database, claim(database, ids[1]))
    lease = claim(database, ids[2])
    store_all(database, lease, lease.episodes, first)
    assert kept() == kinds
    with database.transaction() as session:
        shown = listing.get(session, make_settings(), principal, submission.id).evaluation
        detail = show_evaluation(session, make_settings(), shown.id)
        (listed,) = listing.list_submissions(session, make_settings(), principal).items
    assert [seen.versions for seen in shown.packages] == kinds
    digests = [digest_of_packages(kind) for kind in kinds]
    assert [seen.digest for seen in shown.packages] == digests
    saw = [shard.packages_digest for shard in detail.shards]
    assert saw[:4] == [digests[1], digests[2], digests[0], None]
    assert listed.evaluation.packages == [], "a list is short"


def store_all(
    database: Database, lease: Lease, episodes: Iterable[int], packages: Mapping[str, str] | None = None
) -> None:
    with database.transaction() as session:
        store_episodes(session, lease, [some_record(episode) for episode in episodes], packages=packages)


def test_a_worker_with_other_packages_waits_for_the_evaluation_without_holding_its_shard(
    database: Database, submission: Submission
) -> None:
    """Whoever ends an evaluation locks it before its shards; in another order both would wait for ever."""
    kinds = [{"numpy": "2.5.0"}, {"numpy": "2.4.0"}]
    ids = ids_of(database, submission)
    leases = [claim(database, shard_id) for shard_id in ids[:2]]
    with ThreadPoolExecutor(1) as threads:
        with database.transaction() as session:
            store_episodes(session, leases[0], [some_record(1)], packages=kinds[0])
            storing = threads.submit(store_all, database, leases[1], leases[1].episodes[:1], kinds[1])
            eventually(lambda: _waits(database))
            session.execute(text("SET LOCAL lock_timeout = 2000"))
            lock_held(session, leases[1])
        storing.result(120.0)
    with database.transaction() as session:
        assert newest_evaluation(session, submission).packages == kinds


def _waits(database: Database) -> bool:
    with database.transaction() as session:
        query = "SELECT 1 FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'"
        return session.scalar(text(query)) is not None
