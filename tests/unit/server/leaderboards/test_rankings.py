"""Boards by other keys than the usual ones, as a competition's file may say."""

import csv

from service_factories import LOCK, TASK, TRACK, make_principal, make_score, submit_scored
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.competitions.applying import apply
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation
from vitac.server.decisions.publishing import result_files
from vitac.server.evaluations.logs import LogClaim
from vitac.server.leaderboards.history import past_results
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE

from competitions import OPENS, make_competition, open_now, put_in_place, shown_stage

CLAIM = LogClaim(team=None, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)
CONCERN = [f"tracks.{TRACK}.ranking"]
SCORES = {"A": (50, 4.0), "B": (50, 3.0), "C": (60, 5.0), "D": (0, None), "E": (60, 5.0)}


def test_the_file_of_a_competition_says_what_counts(database: Database) -> None:
    ranking = ["mean_steps", "success_rate", "submitted_at"]
    with database.transaction() as session:
        put_in_place(session, make_competition(ranking=ranking))
    for name, (successes, steps) in SCORES.items():
        with database.transaction() as session:
            team = make_principal(session, f"Team {name}")
            submit_scored(session, team, name, {TASK: make_score(successes, mean_steps=steps)}, at=OPENS)
    with database.transaction() as session:
        view = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
    assert [entry.submission_name for entry in view.entries][:2] == ["B", "A"]
    assert view.ranking_rule.startswith("First comes fewer mean env steps of the successful episodes; then higher")
    assert view.ranking_rule.endswith("The earlier submission is in front.")
    assert {entry.rank_range for entry in view.entries} == {None}, "intervals of success rates say nothing of it"


def test_logs_are_compared_by_the_keys_of_the_competition_too(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(make_competition(ranking=["mean_steps", "success_rate", "submitted_at"])))
        for name, (successes, steps) in SCORES.items():
            scores = {TASK: make_score(successes, mean_steps=steps)}
            team = make_principal(session, f"Team {name}")
            submit_scored(session, team, name, scores, kind=SubmissionKind.LOG, manifest=CLAIM.stored())
    with database.transaction() as session:
        view = log_boards(session, shown_stage(session, TRACK)).view
        same = leaderboard(session, shown_stage(session, TRACK), task=TASK, kind=SubmissionKind.LOG).view.entries
    board = next(board for board in view.boards if board.task == TASK)
    assert [entry.submission_name for entry in board.entries][:2] == ["B", "A"]
    assert [entry.evaluation_id for entry in same] == [entry.evaluation_id for entry in board.entries]
    assert view.ranking_rule.startswith("First comes fewer mean env steps of the successful episodes; then higher")
    assert "Only verified logs are ranked" in view.ranking_rule


def test_results_move_where_the_file_is_applied_with_another_ranking(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition())
    for name, (successes, steps) in SCORES.items():
        with database.transaction() as session:
            measures = {"surface_diff_mm": 0.1 * successes}
            scored = make_score(successes, mean_steps=steps).model_copy(update={"measures": measures})
            submit_scored(
                session, make_principal(session, f"Team {name}"), name, {TASK: scored, LOCK: scored}, at=OPENS
            )

    def read_names() -> list[str]:
        with database.transaction() as session:
            entries = leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
            return [entry.submission_name for entry in entries]

    assert read_names() == ["C", "E", "B", "A", "D"]
    for ranking, expected in (
        (["submitted_at"], ["A", "B", "C", "D", "E"]),
        (["surface_diff_mm", "submitted_at"], ["D", "A", "B", "C", "E"]),
        (None, ["C", "E", "B", "A", "D"]),
    ):
        with database.transaction() as session:
            changed = make_competition(**({} if ranking is None else {"ranking": ranking}))
            apply(session, CONSOLE, CompetitionDefinition.model_validate(changed), confirmed=CONCERN)
        assert read_names() == expected
    with database.transaction() as session:
        changed = make_competition(ranking=["surface_diff_mm", "submitted_at"])
        apply(session, CONSOLE, CompetitionDefinition.model_validate(changed), confirmed=CONCERN)
        view = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        assert [key.title for key in view.ranking.measures] == ["Surface [mm]"]
        assert view.entries[0].measures == {"surface_diff_mm": 0.0}
        assert view.ranking_rule.startswith("First comes lower mean motion of a sensing surface since the grasp; then")
        files, evaluation = result_files(session), session.get_one(Evaluation, view.entries[1].evaluation_id)
        rows = [row for row in csv.DictReader(files["results.csv"].splitlines()) if row["track"] == TRACK]
        assert [(row["team"], row["surface_diff_mm"]) for row in rows[:2]] == [("Team D", "0.0"), ("Team A", "5.0")]
        assert "<th>Surface [mm]</th>" in files["results.html"]
        past, *_ = past_results(session, CONSOLE, evaluation)
        assert (past.success_rate, past.ranked_by.name, past.value) == (0.5, "surface_diff_mm", 5.0)
