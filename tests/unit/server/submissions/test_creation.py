import threading

import pytest
from service_factories import (
    make_principal,
    play,
    play_all,
)
from sqlalchemy import text
from submission_steps import break_policy, create, ids_of, refused, view_of
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.database.states import EvaluationState
from vitac.server.errors import ProblemCode
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import runs


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
        assert session.scalar(text("SELECT count(*) FROM shards")) == 10


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
    progress = view_of(database, other, theirs).evaluation.progress
    assert progress.episodes_done == 270
    assert progress.episodes_reused == 0, "nobody learns that another team sent the same content"


def test_upload_after_a_cancel_takes_the_run_up_where_it_ended(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    play(database, ids_of(database, submission)[0])
    with database.transaction() as session:
        runs.cancel(session, principal, submission.id)
    same, is_new = create(database, principal)
    view = view_of(database, principal, same)
    assert (same.id, is_new) == (submission.id, True)
    assert (view.evaluation.run, view.evaluation.progress.episodes_reused) == (1, 27)
    assert [entry.state for entry in view.evaluations] == ["queued", "cancelled"]


def test_upload_after_a_failure_of_the_policy_begins_a_new_run(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    break_policy(database, submission)
    assert view_of(database, principal, submission).evaluation.state is EvaluationState.FAILED
    _, is_new = create(database, principal)
    view = view_of(database, principal, submission)
    assert is_new
    assert (view.evaluation.run, view.evaluation.progress.episodes_done) == (2, 0)


def test_upload_after_the_machines_failed_takes_the_run_up(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    play(database, ids_of(database, submission)[0])
    with database.transaction() as session:
        lifecycle.fail_by_machines(session, newest_evaluation(session, submission), "lost")
    _, is_new = create(database, principal)
    view = view_of(database, principal, submission)
    assert is_new
    assert (view.evaluation.run, view.evaluation.progress.episodes_done) == (1, 27)


def test_a_submission_that_machines_fail_at_again_and_again_is_started_by_organizers_only(
    database: Database, principal: Principal
) -> None:
    submission, _ = create(database, principal)
    for failures in range(1, runs.MACHINE_FAILURES + 1):
        with database.transaction() as session:
            lifecycle.fail_by_machines(session, newest_evaluation(session, submission), "lost")
        if failures < runs.MACHINE_FAILURES:
            assert create(database, principal)[1]
    for again in (False, True):
        with refused(ProblemCode.NOT_REQUEUABLE):
            create(database, principal, again=again)
    assert len(view_of(database, principal, submission).evaluations) == runs.MACHINE_FAILURES
    assert create(database, principal, "other content")[1]
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
    evaluation = view_of(database, principal, submission).evaluation
    assert (evaluation.state, evaluation.run) == (EvaluationState.QUEUED, 2)


def test_machines_that_fail_at_what_organizers_started_count_for_no_team(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lifecycle, "FREE_FAILURES_PER_DAY", 1)
    submission, _ = create(database, principal)
    for _ in range(runs.MACHINE_FAILURES):
        with database.transaction() as session:
            evaluation = newest_evaluation(session, submission)
            lifecycle.fail_by_machines(session, evaluation, "lost")
            runs.run_again(session, CONSOLE, submission.id)
    with database.transaction() as session:
        last = newest_evaluation(session, submission)
        assert not last.asked_by_team
        assert lifecycle.count_machine_failures(session, Submission.team_id == principal.team_id) == 1
        lifecycle.fail_by_machines(session, last, "lost")
    assert create(database, principal)[1], "the team may still ask for it"
    with database.transaction() as session:
        asked = newest_evaluation(session, submission)
        assert (asked.asked_by_team, asked.charged_at is not None) == (True, True)
        lifecycle.fail_by_machines(session, asked, "lost")
        assert asked.charged_at is not None, "the second failure of the team's own is not free"


def test_organizer_submits_for_a_named_team_only(database: Database, principal: Principal) -> None:
    with refused(ProblemCode.TEAM_REQUIRED):
        create(database, CONSOLE)
    with refused(ProblemCode.UNKNOWN_TEAM):
        create(database, CONSOLE, team="nobody")
    submission, _ = create(database, CONSOLE, team="TEAM  a")
    assert submission.team_id == principal.team_id
