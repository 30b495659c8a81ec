from datetime import datetime

import pytest
from service_factories import make_settings, play, play_all, shard_ids, submit, submit_to
from sqlalchemy import select, text
from submission_steps import make_worker
from vitac.evaluator.tracks import load_track
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.locks import AdvisoryLock, lock_evaluation
from vitac.server.database.models import Evaluation, Shard, Submission
from vitac.server.database.states import EvaluationState
from vitac.server.errors import ServiceError
from vitac.server.evaluations import lifecycle, superseding
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.superseding import supersede_outdated
from vitac.server.operations.state import operations
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue.workers import OWN_SOURCES, declare, versions_here
from vitac.server.settings import OutdatedRule
from vitac.server.submissions import listing

SETTINGS = make_settings()


@pytest.fixture
def outdated(database: Database, principal: Principal) -> Submission:
    """A half-done submission that waits for an evaluator version of yesterday."""
    with database.transaction() as session:
        submission = submit(session, principal)
        first = shard_ids(session, submission)[0]
    play(database, first)
    with database.transaction() as session:
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    return submission


def test_the_new_evaluation_is_charged_in_place_of_the_old_one(database: Database, outdated: Submission) -> None:
    def charges() -> list[datetime]:
        with database.transaction() as session:
            query = select(Evaluation.charged_at).where(Evaluation.charged_at.is_not(None))
            return [charge for charge in session.scalars(query) if charge]

    before = charges()
    make_worker(database)
    with database.transaction() as session:
        assert supersede_outdated(session, SETTINGS) == 1
    assert charges() == before
    assert len(before) == 1


def test_evaluations_keep_their_turns(database: Database, principal: Principal) -> None:
    def turns(state: EvaluationState) -> list[tuple[str, int]]:
        query = select(Submission.digest, Evaluation.turn).join(Evaluation.submission).where(Evaluation.state == state)
        with database.transaction() as session:
            return [(digest, turn) for digest, turn in session.execute(query.order_by(Submission.digest))]

    with database.transaction() as session:
        for content in ("first", "second", "third"):
            submit(session, principal, content)
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    before = turns(EvaluationState.QUEUED)
    make_worker(database)
    with database.transaction() as session:
        assert supersede_outdated(session, SETTINGS) == 3
    assert turns(EvaluationState.CANCELLED) == before
    assert turns(EvaluationState.QUEUED) == before
    assert sorted(turn for _, turn in before) == [0, 1, 2]


@pytest.mark.parametrize("lost", ["track", "task"])
def test_an_evaluation_whose_track_file_or_task_is_gone_waits_and_keeps_no_other_one_waiting(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch, lost: str
) -> None:
    with database.transaction() as session:
        gone = submit_to(session, principal, track="maniskill", task="pick-cube")
        other = submit(session, principal)
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    make_worker(database)
    lost_from(monkeypatch, lost)
    assert supersede(database) == 1
    assert newest(database, other).evaluator_version == evaluator_version()
    waits = newest(database, gone)
    assert (waits.evaluator_version, waits.state) == ("yesterday", EvaluationState.QUEUED)
    monkeypatch.undo()
    assert supersede(database) == 1
    assert newest(database, gone).evaluator_version == evaluator_version()


def lost_from(patch: pytest.MonkeyPatch, lost: str) -> None:
    """Takes away the track, or from the track that stays one of its tasks."""
    if lost == "track":
        patch.setattr(superseding, "list_tracks", lambda: ("track_1",))
        return
    track = load_track("maniskill")
    others = {name: task for name, task in track.tasks.items() if name != "pick-cube"}
    tracks = {"track_1": load_track("track_1"), "maniskill": track.model_copy(update={"tasks": others})}
    for module in (superseding, lifecycle):
        patch.setattr(module, "load_track", tracks.__getitem__)
    patch.setattr(superseding, "list_tracks", lambda: tuple(tracks))


def declare_rule(database: Database, rule: OutdatedRule, version: str | None = None) -> None:
    with database.transaction() as session:
        declare(session, versions_here() | {OWN_SOURCES: version or evaluator_version()}, rule)


def supersede(database: Database) -> int:
    with database.transaction() as session:
        session.execute(text("SET LOCAL statement_timeout = '60s'"))  # else one that waits would hang the test
        return supersede_outdated(session, SETTINGS)


def newest(database: Database, submission: Submission) -> Evaluation:
    with database.transaction() as session:
        return newest_evaluation(session, submission)


def shards(database: Database, submission: Submission) -> list[Shard]:
    with database.transaction() as session:
        return list(newest_evaluation(session, submission).shards)


def test_evaluation_of_a_version_that_nobody_runs_is_begun_again(
    database: Database, principal: Principal, outdated: Submission
) -> None:
    make_worker(database)
    assert supersede(database) == 1
    with database.transaction() as session:
        view = listing.get(session, SETTINGS, principal, outdated.id)
    assert [(entry.state, entry.evaluator_version) for entry in view.evaluations] == [
        (EvaluationState.QUEUED, evaluator_version()),
        (EvaluationState.CANCELLED, "yesterday"),
    ]
    assert supersede(database) == 0
    play_all(database, outdated)
    assert newest(database, outdated).state is EvaluationState.COMPLETED


def test_it_is_left_alone_while_nobody_runs_the_new_version_or_a_worker_of_its_own_lives(
    database: Database, outdated: Submission
) -> None:
    assert supersede(database) == 0
    for version in ("yesterday", evaluator_version()):
        make_worker(database, evaluator_version=version)
        assert supersede(database) == 0
    assert newest(database, outdated).state is EvaluationState.RUNNING


def test_what_has_begun_is_left_to_its_workers_where_the_service_says_so_and_what_waits_is_not(
    database: Database, principal: Principal, outdated: Submission
) -> None:
    with database.transaction() as session:
        waits = submit(session, principal, "waits")
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    declare_rule(database, OutdatedRule.FINISH)
    for version in (evaluator_version(), "yesterday"):
        make_worker(database, evaluator_version=version)
    assert supersede(database) == 1
    assert newest(database, outdated).state is EvaluationState.RUNNING
    assert newest(database, waits).evaluator_version == evaluator_version()


def test_what_no_worker_can_finish_says_so_and_is_restarted_by_an_organizer_only(
    database: Database, principal: Principal, outdated: Submission
) -> None:
    declare_rule(database, OutdatedRule.FINISH)
    make_worker(database)
    assert supersede(database) == 0
    with database.transaction() as session:
        assert listing.get(session, SETTINGS, principal, outdated.id).workers.missing_evaluator == "yesterday"
        assert operations(session, SETTINGS, {}).queue.evaluations_unserved == 1
        with pytest.raises(ServiceError, match="organizer"):
            superseding.restart_unserved(session, principal, SETTINGS)
        before = newest_evaluation(session, outdated).id
        assert superseding.restart_unserved(session, CONSOLE, SETTINGS) == [before]
    with database.transaction() as session:
        assert operations(session, SETTINGS, {}).queue.evaluations_unserved == 0
        again = newest_evaluation(session, outdated)
        with pytest.raises(ServiceError, match="expected one that waits or runs, of another evaluator"):
            superseding.restart(session, CONSOLE, again.id)
    play_all(database, outdated)
    played = {shard.manifest["evaluator_version"] for shard in shards(database, outdated) if shard.manifest}
    assert (newest(database, outdated).state, played) == (EvaluationState.COMPLETED, {evaluator_version()})


def test_only_the_declared_version_restarts_those_of_others(database: Database, outdated: Submission) -> None:
    declare_rule(database, OutdatedRule.RESTART, "1+tomorrow")
    make_worker(database)
    assert supersede(database) == 0
    assert newest(database, outdated).evaluator_version == "yesterday"


def test_finished_evaluations_and_those_of_this_version_are_left_alone(
    database: Database, principal: Principal
) -> None:
    with database.transaction() as session:
        done = submit(session, principal, "done")
    play_all(database, done)
    with database.transaction() as session:
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
        submit(session, principal, "waiting")
    make_worker(database)
    assert supersede(database) == 0


def test_many_evaluations_are_begun_again_in_several_sweeps_the_oldest_first(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(superseding, "BEGUN_AGAIN_AT_ONCE", 2)
    submissions = []
    for name in ("first", "second", "third"):
        with database.transaction() as session:
            submissions.append(submit(session, principal, name))
    with database.transaction() as session:
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    make_worker(database)
    assert supersede(database) == 2
    assert [newest(database, submission).evaluator_version == evaluator_version() for submission in submissions] == [
        True,
        True,
        False,
    ]
    assert supersede(database) == 1
    assert supersede(database) == 0


def test_two_processes_at_once_do_it_once(database: Database, outdated: Submission) -> None:
    make_worker(database)
    with database.transaction() as session:
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": AdvisoryLock.SUPERSEDE})
        assert supersede(database) == 0
    assert supersede(database) == 1


@pytest.mark.parametrize("held", ["evaluation", "shard"])
def test_a_process_that_stands_still_with_a_lock_keeps_no_other_evaluation_from_being_begun_again(
    database: Database, principal: Principal, outdated: Submission, held: str
) -> None:
    with database.transaction() as session:
        other = submit(session, principal, "other")
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    make_worker(database)
    with database.transaction() as stuck:
        if held == "evaluation":
            lock_evaluation(stuck, newest(database, outdated).id)
        else:
            stuck.get_one(Shard, shard_ids(stuck, outdated)[-1], with_for_update=True)
        assert supersede(database) == 1
        assert newest(database, outdated).state is EvaluationState.RUNNING
        assert newest(database, other).evaluator_version == evaluator_version()
    assert supersede(database) == 1
    assert newest(database, outdated).evaluator_version == evaluator_version()
