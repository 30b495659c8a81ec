"""Boards by other keys than the usual ones, as a competition's file may say."""

from itertools import permutations

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.competition.definition import DEFAULT_RANKING, RankingKey
from vitac.server.db.engine import Database
from vitac.server.leaderboards.best_entries import Board, best_entries, places
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.logs.claims import LogClaim

from competitions import OPENS, make_competition, open_now, put_in_place, shown_stage

CLAIM = LogClaim(team=None, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)
SCORES = {"A": (50, 4.0), "B": (50, 3.0), "C": (60, 5.0), "D": (0, None), "E": (60, 5.0)}
RANKINGS = [
    (*keys, RankingKey.SUBMITTED_AT)
    for length in range(3)
    for keys in permutations([RankingKey.SUCCESS_RATE, RankingKey.MEAN_STEPS], length)
]


@pytest.fixture
def filled(database: Database) -> Database:
    """A board with ties, a missing mean of steps, and no competition."""
    for name, (successes, steps) in SCORES.items():
        with database.transaction() as session:  # each in one of its own, for another time of submission
            team = make_principal(session, f"Team {name}")
            submit_scored(session, team, name, {TASK: make_score(successes, mean_steps=steps)})
    return database


def key_of(name: str, ranking: tuple[RankingKey, ...]) -> tuple[float, ...]:
    successes, steps = SCORES[name]
    values = {
        RankingKey.SUCCESS_RATE: -successes,
        RankingKey.MEAN_STEPS: float("inf") if steps is None else steps,
        RankingKey.SUBMITTED_AT: list(SCORES).index(name),
    }
    return tuple(values[key] for key in ranking)


@pytest.mark.parametrize("ranking", RANKINGS)
def test_entries_are_compared_key_by_key(filled: Database, ranking: tuple[RankingKey, ...]) -> None:
    with filled.transaction() as session:
        entries = best_entries(session, Board(track=TRACK, task=TASK, ranking=ranking))
        board = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        name_of = {entry.submission_id: entry.submission_name for entry in board.entries}
        shown = [name_of[entry.submission_id] for entry in entries]
        assert shown == sorted(SCORES, key=lambda name: key_of(name, ranking))
        found = places(session, Board(track=TRACK, ranking=ranking))[TASK]
        assert sorted(name_of, key=lambda submission: found[submission].rank) == [
            entry.submission_id for entry in entries
        ]
        if ranking == DEFAULT_RANKING:
            assert [entry.submission_name for entry in board.entries] == shown


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
    assert view.entries[0].rank_range == (1, 4)
    assert view.entries[-1].rank_range == (5, 5)


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
