"""One submission leaves all boards with a reason; its team keeps its other results and goes on submitting."""

import pytest
from service_factories import TASK, TRACK, complete_scored, make_principal, make_score, submit, submit_scored
from submission_steps import SETTINGS, refused
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import listing, runs, withdrawal

from competitions import shown_stage

WHY = "trained on the sealed list"


def on_board(database: Database) -> list[tuple[str, str]]:
    with database.transaction() as session:
        board = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        return [(entry.team, entry.submission_name) for entry in board.entries]


def test_a_disqualified_submission_leaves_the_board_to_the_next_best_of_its_team(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        best = submit_scored(session, ants, "best", {TASK: make_score(90)})
        submit_scored(session, ants, "second", {TASK: make_score(40)})
        submit_scored(session, bees, "bees", {TASK: make_score(60)})
        best.is_public = True
    assert on_board(database) == [("Ants", "best"), ("Bees", "bees")]
    with database.transaction() as session:
        assert public_among(session, [best.id])
        withdrawal.disqualify(session, CONSOLE, best.id, WHY)
    assert on_board(database) == [("Bees", "bees"), ("Ants", "second")]
    with database.transaction() as session:
        view = listing.get(session, SETTINGS, ants, best.id)
        assert (view.disqualified_for, view.rank, view.evaluation.success_rate is not None) == (WHY, None, True)
        assert not public_among(session, [best.id])
        entry = newest_entries(session)[0]
        assert (entry.action, entry.before, entry.after) == (
            "submission.disqualify",
            {"reason": None},
            {"reason": WHY},
        )
        submit(session, ants, "another")
    with database.transaction() as session:
        for _ in range(2):
            withdrawal.reinstate(session, CONSOLE, best.id)
        assert [entry.action for entry in newest_entries(session, 2)].count("submission.reinstate") == 1
    assert on_board(database) == [("Ants", "best"), ("Bees", "bees")]


def test_results_that_it_gets_later_are_on_no_board_either(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session, "Ants")
        submission = submit_scored(session, team, "best", {TASK: make_score(90)})
        withdrawal.disqualify(session, CONSOLE, submission.id, WHY)
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
        complete_scored(session, submission, {TASK: make_score(95)})
    assert on_board(database) == []


def test_the_same_content_is_not_evaluated_again_for_its_team(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session, "Ants")
        submission = submit(session, team)
        withdrawal.disqualify(session, CONSOLE, submission.id, WHY)
        for again in (False, True):
            with pytest.raises(ServiceError, match=WHY) as caught:
                submit(session, team, again=again)
            assert caught.value.code is ProblemCode.SUBMISSION_DISQUALIFIED


def test_only_organizers_disqualify_and_only_once(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session, "Ants")
        submission = submit(session, team)
        for by in (team, Principal(role=Role.JUDGE), VISITOR):
            with pytest.raises(ServiceError):
                withdrawal.disqualify(session, by, submission.id, WHY)
            with pytest.raises(ServiceError):
                withdrawal.reinstate(session, by, submission.id)
        for reason in ("", "x" * 201):
            with refused(ProblemCode.INVALID_REQUEST):
                withdrawal.disqualify(session, CONSOLE, submission.id, reason)
        withdrawal.disqualify(session, CONSOLE, submission.id, WHY)
        with refused(ProblemCode.SUBMISSION_DISQUALIFIED):
            withdrawal.disqualify(session, CONSOLE, submission.id, WHY)


def test_a_log_leaves_its_board_too(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session, "Ants")
        claim = {"team": None, "episodes": 1, "successes": 1, "success_rate": 1.0, "mean_steps": 3.0}
        log = submit_scored(session, team, "log", {TASK: make_score(90)}, kind=SubmissionKind.LOG, manifest=claim)
        stage = shown_stage(session, TRACK)
        assert leaderboard(session, stage, task=TASK, kind=SubmissionKind.LOG).view.entries
        withdrawal.disqualify(session, CONSOLE, log.id, WHY)
        session.flush()
        assert not leaderboard(session, stage, task=TASK, kind=SubmissionKind.LOG).view.entries
