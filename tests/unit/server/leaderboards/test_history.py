import pytest
from service_factories import LOCK, TASK, make_principal, make_score, outdate, submit, submit_scored
from vitac.server.database.engine import Database
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.history import past_results
from vitac.server.principals import Principal


def test_a_teams_results_in_the_tasks_of_a_submission(database: Database) -> None:
    with database.transaction() as session:
        ours, theirs = make_principal(session), make_principal(session, "Team B")
        submit_scored(session, ours, "old", {TASK: make_score(10)})
        outdate(session)
        submit_scored(session, ours, "first", {TASK: make_score(50), LOCK: make_score(20)})
        shown = submit_scored(session, ours, "second", {TASK: make_score(75)})
        submit_scored(session, theirs, "other", {TASK: make_score(99)})
        waiting = submit(session, ours, "waits")
        found = past_results(session, ours, newest_evaluation(session, shown))
        assert past_results(session, ours, newest_evaluation(session, waiting)) == []
    assert {(result.submission_name, result.task, result.success_rate) for result in found} == {
        ("first", TASK, 0.5),
        ("second", TASK, 0.75),
    }


def test_foreign_submissions_have_no_history(database: Database) -> None:
    with database.transaction() as session:
        shown = submit_scored(session, make_principal(session), "first", {TASK: make_score(50)})
        other: Principal = make_principal(session, "Team B")
        with pytest.raises(ServiceError) as caught:
            past_results(session, other, newest_evaluation(session, shown))
    assert caught.value.code is ProblemCode.NOT_FOUND
