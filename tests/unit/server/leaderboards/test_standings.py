import pytest
from service_factories import (
    LOCK,
    TASK,
    TRACK,
    complete_scored,
    make_principal,
    make_score,
    make_settings,
    outdate,
    submit_scored,
)
from vitac.evaluator.scoring.score import interval_of_mean
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.engine import Database
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE
from vitac.server.submissions import listing, runs
from vitac.server.views.leaderboards import LeaderboardView
from vitac.server.views.submissions import RankView

from competitions import shown_stage


def board_of(database: Database, task: str | None = None) -> LeaderboardView:
    with database.transaction() as session:
        return leaderboard(session, shown_stage(session, TRACK), task=task).view


def standings(board: LeaderboardView) -> list[tuple[int | None, str, str]]:
    return [(entry.rank, entry.team, entry.submission_name) for entry in board.entries]


@pytest.fixture
def two_teams(database: Database) -> Database:
    """Team A enters both tasks at once and the lock once more alone; Team B enters the peg only, and is good at it."""
    with database.transaction() as session:
        first, second = make_principal(session, "Team A"), make_principal(session, "Team B")
        submit_scored(session, first, "both", {TASK: make_score(50), LOCK: make_score(60, 160, 9.0)})
        submit_scored(session, first, "lock", {LOCK: make_score(100, 160)})
        submit_scored(session, second, "peg", {TASK: make_score(80)})
    return database


def test_together_the_tasks_of_the_track_count_equally_and_a_missing_one_as_nothing(two_teams: Database) -> None:
    board = board_of(two_teams)
    assert standings(board) == [(1, "Team A", "both"), (2, "Team B", "peg")]
    both, peg = board.entries
    assert (both.success_rate, both.mean_steps) == ((0.5 + 60 / 160) / 2, 6.5)
    assert (peg.success_rate, peg.mean_steps) == (0.4, None)
    interval = interval_of_mean([make_score(50), make_score(60, 160)], of=2)
    assert both.success_rate_interval == (interval.low, interval.high)
    assert [score.task for score in both.scores] == [TASK, LOCK]
    assert "mean of the success rates" in board.ranking_rule


def test_a_task_has_a_board_of_all_that_play_it_with_each_teams_best_entry_there(two_teams: Database) -> None:
    board = board_of(two_teams, LOCK)
    assert standings(board) == [(1, "Team A", "lock")]
    assert (board.entries[0].success_rate, board.entries[0].mean_steps) == (100 / 160, 4.0)
    assert standings(board_of(two_teams, TASK)) == [(1, "Team B", "peg"), (2, "Team A", "both")]
    assert [score.task for score in board_of(two_teams, TASK).entries[1].scores] == [TASK]


def test_a_blind_run_is_a_reference_that_ranks_nobody(database: Database) -> None:
    scores = {task: make_score(successes) for task, successes in (("sensor-standard", 80), ("sensor-blind", 60))}
    with database.transaction() as session:
        by = make_principal(session, "Team A")
        submission = submit_scored(session, by, "gel", scores, track="track_3")
        boards = {task: leaderboard(session, shown_stage(session, "track_3"), task=task).view for task in scores}
        shown = listing.get(session, make_settings(), by, submission.id)
    assert [board.entries[0].rank for board in boards.values()] == [1, None]
    assert [board.is_reference for board in boards.values()] == [False, True]
    assert shown.task_ranks == {"sensor-standard": RankView(rank=1, of=1)}


def test_ties_go_to_the_earlier_submission_also_when_it_is_evaluated_again_later(database: Database) -> None:
    scores = {TASK: make_score(80)}
    submissions = []
    for team in ("earlier", "later"):
        with database.transaction() as session:
            submissions.append(submit_scored(session, make_principal(session, team), team, scores))
    before = {entry.team: entry.submitted_at for entry in board_of(database, TASK).entries}
    with database.transaction() as session:
        outdate(session)
    for submission in reversed(submissions):
        with database.transaction() as session:
            complete_scored(session, runs.run_again(session, CONSOLE, submission.id), scores)
    board = board_of(database, TASK)
    assert [(entry.rank, entry.team, entry.stale) for entry in board.entries] == [
        (1, "earlier", False),
        (2, "later", False),
    ]
    assert {entry.team: entry.submitted_at for entry in board.entries} == before
    assert before == {submission.name: submission.submitted_at for submission in submissions}


def test_a_board_without_ranks_says_which_evaluator_made_its_entries_and_what_brings_the_ranks_back(
    database: Database,
) -> None:
    with database.transaction() as session:
        old = [make_principal(session, team) for team in ("Ants", "Bees")]
        submissions = [submit_scored(session, team, "old", {TASK: make_score(80)}) for team in old]
        outdate(session)
    board = board_of(database)
    (made_by,) = {entry.evaluator_version for entry in board.entries}
    assert [found.rank for found in board.entries] == [None, None]
    assert board.unranked == (
        f"2 of 2 entries have no rank: evaluator {made_by} made them, and this board ranks results of "
        f"evaluator {board.evaluator_version}, as results of two evaluators are not comparable. A submission gets a "
        "rank once it is evaluated again: organizers do so with "
        f"`vitac admin rejudge start --track {TRACK} --reason REASON`, then `apply`."
    )
    with database.transaction() as session:
        shown = listing.get(session, make_settings(), old[0], submissions[0].id)
        assert shown.unranked is not None
        assert shown.unranked.startswith(f"It has no rank: evaluator {made_by} made its result")
        complete_scored(session, runs.run_again(session, CONSOLE, submissions[0].id), {TASK: make_score(80)})
    with database.transaction() as session:
        assert listing.get(session, make_settings(), old[0], submissions[0].id).unranked is None
    again = board_of(database)
    assert again.unranked is not None
    assert again.unranked.startswith("1 of 2 entries has no rank: evaluator ")
    with database.transaction() as session:
        complete_scored(session, runs.run_again(session, CONSOLE, submissions[1].id), {TASK: make_score(80)})
    assert board_of(database).unranked is None


def test_missing_steps_come_after_all_others_of_the_same_rate(database: Database) -> None:
    with database.transaction() as session:
        one = {TASK: make_score(80)}
        both = {TASK: make_score(40), LOCK: make_score(40, mean_steps=50.0)}
        submit_scored(session, make_principal(session, "one"), "a", one)
        submit_scored(session, make_principal(session, "both"), "b", both)
    assert [entry.team for entry in board_of(database).entries] == ["both", "one"]


def test_logs_are_not_ranked_with_models(two_teams: Database) -> None:
    with two_teams.transaction() as session:
        submit_scored(session, make_principal(session, "Team C"), "log", {LOCK: make_score(9)}, kind=SubmissionKind.LOG)
    assert standings(board_of(two_teams, LOCK)) == [(1, "Team A", "lock")]


def test_a_submission_knows_its_places_and_what_it_lacks(two_teams: Database) -> None:
    with two_teams.transaction() as session:
        listed = listing.list_submissions(session, make_settings(), CONSOLE).items
    views = {view.name: view for view in listed}
    first_of_two, second_of_two = RankView(rank=1, of=2), RankView(rank=2, of=2)
    assert (views["both"].rank, views["both"].task_ranks) == (first_of_two, {TASK: second_of_two})
    assert (views["lock"].rank, views["lock"].task_ranks) == (None, {LOCK: RankView(rank=1, of=1)})
    assert (views["peg"].rank, views["peg"].task_ranks) == (second_of_two, {TASK: first_of_two})
    assert [views[name].missing_tasks for name in ("both", "lock", "peg")] == [[], [TASK], [LOCK]]
    assert views["both"].evaluation.success_rate == (0.5 + 60 / 160) / 2
