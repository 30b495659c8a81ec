import asyncio
import threading
from typing import Any
from uuid import uuid4

import pytest
from service_factories import (
    TASK,
    TRACK,
    claim,
    finish,
    make_failed_record,
    make_principal,
    make_record,
    make_settings,
    make_upload,
    play,
    play_all,
    shard_ids,
    store,
)
from sqlalchemy import text
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.shards.result import ShardEnd
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts.principals import CONSOLE, Principal
from vitac.server.db.engine import Database
from vitac.server.db.models import Submission, Worker
from vitac.server.db.states import EvaluationState, WorkerState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations import lifecycle
from vitac.server.queue import workers
from vitac.server.submissions import submissions
from vitac.server.views.views import SubmissionView

SETTINGS = make_settings()


@pytest.fixture
def principal(database: Database) -> Principal:
    with database.transaction() as session:
        return make_principal(session)


def view_of(database: Database, principal: Principal, submission: Submission) -> SubmissionView:
    with database.transaction() as session:
        return submissions.get(session, SETTINGS, principal, submission.id)


def create(
    database: Database, principal: Principal, content: str = "content", **options: Any
) -> tuple[Submission, bool]:
    with database.transaction() as session:
        return submissions.create(session, principal, make_upload(content), **options)


def make_worker(database: Database, **changes: Any) -> None:
    values = {
        "host": "h",
        "pid": 1,
        "slots": 2,
        "state": WorkerState.READY,
        "evaluator_version": evaluator_version(),
        "platform_class": "p",
        "isolation": "i",
        "message": "",
    }
    with database.transaction() as session:
        workers.register(session, Worker(**(values | changes)))


def refused(code: ProblemCode) -> "pytest.RaisesExc[ServiceError]":
    return pytest.raises(ServiceError, check=lambda error: error.code is code)


def test_new_submission_is_queued_with_its_position(database: Database, principal: Principal) -> None:
    first, is_new = create(database, principal, "one")
    second, _ = create(database, principal, "two")
    assert is_new
    view = view_of(database, principal, second)
    assert view.evaluation.state is EvaluationState.QUEUED
    assert view.evaluation.queue_position == 2
    assert view.evaluation.eta_s is None
    assert view.evaluation.progress.episodes_total == 270
    assert view.workers.alive == 0
    play(database, ids_of(database, first)[0])
    assert view_of(database, principal, first).evaluation.queue_position is None
    assert view_of(database, principal, second).evaluation.queue_position == 1


def ids_of(database: Database, submission: Submission) -> list[int]:
    with database.transaction() as session:
        return shard_ids(session, submission)


def test_same_content_again_is_the_same_submission(database: Database, principal: Principal) -> None:
    first, _ = create(database, principal)
    again, is_new = create(database, principal)
    assert (again.id, is_new) == (first.id, False)
    play_all(database, first)
    done, is_new = create(database, principal)
    assert (done.id, is_new) == (first.id, False)


def test_same_upload_many_times_at_once_is_one_submission_with_one_evaluation(
    database: Database, principal: Principal
) -> None:
    answers = []
    barrier = threading.Barrier(6)

    def upload() -> None:
        barrier.wait()
        answers.append(create(database, principal))

    threads = [threading.Thread(target=upload) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({submission.id for submission, _ in answers}) == 1
    assert sorted(is_new for _, is_new in answers) == [False] * 5 + [True]
    with database.transaction() as session:
        assert session.scalar(text("SELECT count(*) FROM shards")) == 9


def test_same_content_of_two_teams_is_two_submissions_that_share_episodes(
    database: Database, principal: Principal
) -> None:
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    mine, _ = create(database, principal)
    play_all(database, mine)
    theirs, is_new = create(database, other)
    assert is_new
    assert theirs.id != mine.id
    view = view_of(database, other, theirs)
    assert view.evaluation.progress.episodes_reused == view.evaluation.progress.episodes_done == 270


def test_upload_after_a_cancel_takes_the_run_up_where_it_ended(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    play(database, ids_of(database, submission)[0])
    with database.transaction() as session:
        submissions.cancel(session, principal, submission.id)
    same, is_new = create(database, principal)
    view = view_of(database, principal, same)
    assert (same.id, is_new) == (submission.id, True)
    assert (view.evaluation.run, view.evaluation.progress.episodes_reused) == (1, 30)
    assert [entry.state for entry in view.evaluations] == ["queued", "cancelled"]


def test_upload_after_a_failure_of_the_policy_begins_a_new_run(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    break_policy(database, submission)
    assert view_of(database, principal, submission).evaluation.state is EvaluationState.FAILED
    _, is_new = create(database, principal)
    view = view_of(database, principal, submission)
    assert is_new
    assert (view.evaluation.run, view.evaluation.progress.episodes_done) == (2, 0)


def break_policy(database: Database, submission: Submission) -> None:
    lease = claim(database, ids_of(database, submission)[0])
    store(database, lease, [make_failed_record(n, output=f"out {n}") for n in (1, 2, 3)])
    assert view_of(database, CONSOLE, submission).evaluation.log_tail == "out 3"
    finish(database, lease, ShardEnd.BROKEN)


def test_upload_after_the_machines_failed_takes_the_run_up(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    play(database, ids_of(database, submission)[0])
    with database.transaction() as session:
        lifecycle.fail_by_machines(session, submissions.newest_evaluation(session, submission), "lost")
    _, is_new = create(database, principal)
    view = view_of(database, principal, submission)
    assert is_new
    assert (view.evaluation.run, view.evaluation.progress.episodes_done) == (1, 30)


def test_failed_evaluation_shows_verdict_sentence_and_output(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    break_policy(database, submission)
    evaluation = view_of(database, principal, submission).evaluation
    assert evaluation.verdict is not None
    assert (evaluation.verdict.code, evaluation.verdict.task, evaluation.verdict.episode) == ("crashed", TASK, 1)
    assert evaluation.verdict.title.endswith("say where.")
    assert evaluation.verdict.message == "failed in 1"
    assert evaluation.log_tail == "out 1"


def test_eta_counts_own_and_earlier_episodes_over_the_slots_of_living_workers(
    database: Database, principal: Principal
) -> None:
    first, _ = create(database, principal, "one")
    second, _ = create(database, principal, "two")
    play(database, ids_of(database, first)[0])
    assert view_of(database, principal, first).evaluation.eta_s is None
    make_worker(database, slots=2)
    assert view_of(database, principal, first).evaluation.eta_s == pytest.approx(240 * 0.5 / 2)
    assert view_of(database, principal, second).evaluation.eta_s == pytest.approx((240 + 270) * 0.5 / 2)


def test_workers_that_are_silent_refusing_or_of_another_version_do_not_count_as_alive(
    database: Database, principal: Principal
) -> None:
    make_worker(database, state=WorkerState.REFUSING)
    make_worker(database, state=WorkerState.STOPPED)
    make_worker(database, evaluator_version="other")
    make_worker(database)
    with database.transaction() as session:
        session.execute(
            text("UPDATE workers SET heartbeat_at = now() - interval '1 hour' WHERE evaluator_version <> 'other'")
        )
    submission, _ = create(database, principal)
    view = view_of(database, principal, submission)
    assert view.workers.alive == 0
    assert view.workers.last_heartbeat_at is not None


def test_foreign_submission_looks_like_a_missing_one(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    for identity in (submission.id, uuid4()):
        for call in (
            lambda session, wanted: submissions.get(session, SETTINGS, other, wanted),
            lambda session, wanted: submissions.cancel(session, other, wanted),
            lambda session, wanted: submissions.episodes(session, other, wanted),
            lambda session, wanted: submissions.list_submissions(session, SETTINGS, other, before=wanted),
        ):
            with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
                call(session, identity)
    assert view_of(database, CONSOLE, submission).id == submission.id


def test_lists_show_own_submissions_to_a_team_and_all_to_an_organizer_page_by_page(
    database: Database, principal: Principal
) -> None:
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    mine = [create(database, principal, f"m{n}")[0].id for n in range(3)]
    theirs = create(database, other, "t")[0].id
    with database.transaction() as session:
        page = submissions.list_submissions(session, SETTINGS, principal, limit=2)
        rest = submissions.list_submissions(session, SETTINGS, principal, limit=2, before=page.next_before)
        assert [item.id for item in (*page.items, *rest.items)] == mine[::-1]
        assert rest.next_before is None
        assert len(submissions.list_submissions(session, SETTINGS, CONSOLE).items) == 4
        of_b = submissions.list_submissions(session, SETTINGS, CONSOLE, team="team b")
        assert [item.id for item in of_b.items] == [theirs]
        queued = submissions.list_submissions(session, SETTINGS, CONSOLE, state=EvaluationState.QUEUED, track=TRACK)
        assert len(queued.items) == 4
        assert submissions.list_submissions(session, SETTINGS, CONSOLE, state=EvaluationState.FAILED).items == []
        assert submissions.list_submissions(session, SETTINGS, CONSOLE, track="other").items == []


def test_finished_evaluation_cannot_be_cancelled(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    play_all(database, submission)
    with refused(ProblemCode.NOT_CANCELLABLE), database.transaction() as session:
        submissions.cancel(session, principal, submission.id)


def test_organizer_submits_for_a_named_team_only(database: Database, principal: Principal) -> None:
    with refused(ProblemCode.TEAM_REQUIRED):
        create(database, CONSOLE)
    with refused(ProblemCode.UNKNOWN_TEAM):
        create(database, CONSOLE, team="nobody")
    submission, _ = create(database, CONSOLE, team="TEAM  a")
    assert submission.team_id == principal.team_id


def test_organizer_runs_a_finished_submission_again_and_the_log_says_who(
    database: Database, principal: Principal
) -> None:
    submission, _ = create(database, principal)
    with refused(ProblemCode.NOT_REQUEUABLE), database.transaction() as session:
        submissions.run_again(session, CONSOLE, submission.id)
    play_all(database, submission)
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        submissions.run_again(session, principal, submission.id)
    with database.transaction() as session:
        submissions.run_again(session, CONSOLE, submission.id)
    assert view_of(database, principal, submission).evaluation.run == 2
    with database.transaction() as session:
        lines = session.execute(text("SELECT actor, action FROM audit_log ORDER BY id")).all()
    assert ("organizer:console", "submission.requeue") in lines
    assert ("team:Team A", "submission.evaluate") in lines


def test_episodes_are_listed_in_order(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    lease = claim(database, ids_of(database, submission)[0])
    store(database, lease, [make_record(4, EpisodeOutcome.TACTILE), make_record(2)])
    with database.transaction() as session:
        listed = submissions.episodes(session, principal, submission.id)
    assert [(view.episode, view.outcome, view.success) for view in listed] == [
        (2, "success", True),
        (4, "tactile", False),
    ]


def test_watching_gives_each_change_and_ends_with_the_evaluation(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)

    async def follow() -> list[EvaluationState]:
        states = []
        async for view in submissions.watch(database, SETTINGS, principal, submission.id):
            if view.evaluation.state not in states:
                states.append(view.evaluation.state)
            if len(states) == 1 and view.evaluation.progress.episodes_done == 0:
                await asyncio.to_thread(play_all, database, submission)
        return states

    states = asyncio.run(follow())
    assert states[0] is EvaluationState.QUEUED
    assert states[-1] is EvaluationState.COMPLETED
