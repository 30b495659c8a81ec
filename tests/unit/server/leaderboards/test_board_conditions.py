"""What is on a board and what is not, condition by condition: each of them was once left out to see a test fail."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import UUID

import pytest
from service_factories import LOCK, TASK, TRACK, add_result, make_score
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.engine import Database
from vitac.server.database.models import ALL_TASKS, Evaluation, Team
from vitac.server.database.states import Role
from vitac.server.leaderboards import history
from vitac.server.leaderboards.best_entries import BestEntry, Board, best_entries, places
from vitac.server.leaderboards.history import past_results
from vitac.server.leaderboards.log_boards import MAX_TEXT_LOGS, _newest_text_logs
from vitac.server.principals import Principal

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
UNTIL = BEGIN + timedelta(hours=1)
PEGS = Board(track=TRACK, task=TASK)
OLD = "0+old"


class Results:
    """Teams by name and their results, in one transaction."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.teams: dict[str, Team] = {}
        self.number = 0

    def add(self, team: str, successes: int, *, task: str = TASK, minute: int = 0, **changes: Any) -> Evaluation:
        """Adds a result; changes are to its rows on the boards."""
        if team not in self.teams:
            self.teams[team] = Team(name=team, name_key=team.lower())
            self.session.add(self.teams[team])
            self.session.flush()
        self.number += 1
        moment = BEGIN + timedelta(minutes=minute)
        played = {task: make_score(successes)}
        evaluation = add_result(self.session, self.number, self.teams[team], played, moment)
        self.change(evaluation, **changes)
        return evaluation

    def change(self, evaluation: Evaluation, **changes: Any) -> None:
        for row in evaluation.board_results:
            for name, value in changes.items():
                if name != "board" or row.board != ALL_TASKS:
                    setattr(row, name, value)
        self.session.flush()

    def shown(self, entries: list[BestEntry]) -> list[tuple[int | None, str]]:
        found = (self.session.get_one(Evaluation, entry.evaluation_id) for entry in entries)
        return [(entry.rank, one.submission.team.name) for entry, one in zip(entries, found, strict=True)]


@pytest.fixture
def results(session: Session) -> Results:
    return Results(session)


@pytest.fixture
def session(database: Database) -> Any:
    with database.transaction() as opened:
        yield opened
        opened.rollback()


def placed_on_pegs(results: Results, until: datetime = Board.until) -> list[UUID]:
    found = places(results.session, Board(track=TRACK, until=until))[TASK]
    assert [place.rank for place in found.values()] == list(range(1, len(found) + 1))
    assert {place.of for place in found.values()} <= {len(found)}
    return list(found)


def test_a_board_has_the_results_of_its_track_stage_kind_and_task_only(results: Results) -> None:
    ours = results.add("Ours", 1)
    results.add("Track", 90, track="track_2")
    results.add("Stage", 91, stage="final")
    results.add("Kind", 92, kind=SubmissionKind.LOG)
    results.add("Board", 93, board=LOCK)
    entries = best_entries(results.session, PEGS)
    assert [(entry.rank, entry.evaluation_id, entry.submission_id) for entry in entries] == [
        (1, ours.id, ours.submission_id)
    ]
    assert placed_on_pegs(results) == [ours.submission_id]
    for board, team in (
        (Board(track="track_2", task=TASK), "Track"),
        (Board(track=TRACK, task=TASK, stage="final"), "Stage"),
        (Board(track=TRACK, task=TASK, kind=SubmissionKind.LOG), "Kind"),
        (Board(track=TRACK, task=LOCK), "Board"),
    ):
        assert results.shown(best_entries(results.session, board)) == [(1, team)]


def test_a_result_counts_from_the_moment_it_is_complete(results: Results) -> None:
    in_time = results.add("In time", 10, finished_at=UNTIL)
    late = results.add("Late", 90, finished_at=UNTIL + timedelta(microseconds=1))
    better = results.add("In time", 80, finished_at=UNTIL + timedelta(seconds=1))
    assert results.shown(best_entries(results.session, replace(PEGS, until=UNTIL))) == [(1, "In time")]
    assert placed_on_pegs(results, UNTIL) == [in_time.submission_id]
    assert results.shown(best_entries(results.session, PEGS)) == [(1, "Late"), (2, "In time")]
    assert placed_on_pegs(results) == [late.submission_id, better.submission_id]
    results.add("Older", 99, finished_at=UNTIL + timedelta(seconds=1), evaluator_version=OLD)
    assert results.shown(best_entries(results.session, replace(PEGS, until=UNTIL))) == [(1, "In time")]


def test_other_versions_and_copies_follow_unranked_where_a_team_has_nothing_better(results: Results) -> None:
    results.add("Ranked", 10)
    results.add("Ranked", 95, evaluator_version=OLD)
    results.add("Ranked", 96, is_copy=True)
    results.add("Old", 50, evaluator_version=OLD)
    results.add("Old", 60, evaluator_version="0+older")
    results.add("Copy", 70, is_copy=True)
    results.add("Both", 80, evaluator_version=OLD)
    results.add("Both", 20, is_copy=True)
    entries = best_entries(results.session, PEGS)
    assert results.shown(entries) == [(1, "Ranked"), (None, "Both"), (None, "Copy"), (None, "Old")]
    (of_old,) = (one for one in entries if results.shown([one]) == [(None, "Old")])
    assert results.session.get_one(Evaluation, of_old.evaluation_id).evaluator_version is not None
    rows = results.session.get_one(Evaluation, of_old.evaluation_id).board_results
    assert {row.evaluator_version for row in rows} == {"0+older"}, "the better of the two"


def test_a_rank_on_another_board_hides_nothing_on_this_one(results: Results) -> None:
    results.add("Ours", 50, evaluator_version=OLD)
    moved = results.add("Ours", 60)
    before = {name: getattr(moved.board_results[0], name) for name in ("track", "stage", "kind", "finished_at")}
    assert results.shown(best_entries(results.session, PEGS)) == [(1, "Ours")]
    for elsewhere in ({"track": "track_2"}, {"stage": "final"}, {"kind": SubmissionKind.LOG}, {"finished_at": UNTIL}):
        results.change(moved, **before | elsewhere)
        until = UNTIL - timedelta(seconds=1) if "finished_at" in elsewhere else Board.until
        assert results.shown(best_entries(results.session, replace(PEGS, until=until))) == [(None, "Ours")], elsewhere
    results.change(moved, **before, board=LOCK)
    assert results.shown(best_entries(results.session, PEGS)) == [(None, "Ours")]


def test_a_rank_of_another_team_hides_nothing(results: Results) -> None:
    results.add("Theirs", 60)
    results.add("Ours", 50, evaluator_version=OLD)
    assert results.shown(best_entries(results.session, PEGS)) == [(1, "Theirs"), (None, "Ours")]


def test_who_is_disqualified_is_on_no_board_and_takes_no_place(results: Results) -> None:
    ours = results.add("Ours", 10)
    results.add("Out", 90)
    results.add("Out of date", 91, evaluator_version=OLD)
    text_logs = [results.add(team, 50, kind=SubmissionKind.TEXT_LOG) for team in ("Ours", "Out")]
    for team in ("Out", "Out of date"):
        results.teams[team].disqualified_at, results.teams[team].disqualified_for = BEGIN, "test"
    results.session.flush()
    assert results.shown(best_entries(results.session, PEGS)) == [(1, "Ours")]
    assert placed_on_pegs(results) == [ours.submission_id]
    assert newest_text_logs(results) == [text_logs[0].id]


def test_places_are_of_each_board_by_itself(results: Results) -> None:
    assert places(results.session, Board(track=TRACK)) == {None: {}, TASK: {}, LOCK: {}}
    ours, lock = results.add("Ours", 10), results.add("Ours", 90, task=LOCK)
    theirs, third = results.add("Theirs", 50), results.add("Third", 40)
    other_lock = results.add("Third", 50, task=LOCK)
    found = places(results.session, Board(track=TRACK))
    assert {board: [*shown] for board, shown in found.items()} == {
        None: [lock.submission_id, *(one.submission_id for one in sorted_by_time_and_id(theirs, other_lock))],
        TASK: [theirs.submission_id, third.submission_id, ours.submission_id],
        LOCK: [lock.submission_id, other_lock.submission_id],
    }
    assert {board: {place.of for place in shown.values()} for board, shown in found.items()} == {
        None: {3},
        TASK: {3},
        LOCK: {2},
    }


def test_places_of_another_stage_are_read_by_themselves(results: Results) -> None:
    first, better = results.add("First", 10, minute=1), results.add("Better", 50, minute=2)
    in_final = results.add("Final", 90, stage="final")
    for _ in range(2):  # the second time they are kept
        assert list(places(results.session, Board(track=TRACK))[TASK]) == [better.submission_id, first.submission_id]
        assert list(places(results.session, Board(track=TRACK, stage="final"))[TASK]) == [in_final.submission_id]


def sorted_by_time_and_id(*evaluations: Evaluation) -> list[Evaluation]:
    return sorted(evaluations, key=lambda one: (one.created_at, one.id))


def test_equal_entries_stand_in_the_order_of_their_ids(results: Results) -> None:
    made = [results.add(f"Team {number}", 50) for number in range(6)]
    entries = best_entries(results.session, PEGS)
    assert [entry.evaluation_id for entry in entries] == sorted(one.id for one in made)
    assert [entry.rank for entry in entries] == [1, 2, 3, 4, 5, 6]


def newest_text_logs(results: Results, **changes: Any) -> list[UUID]:
    named = {"track": TRACK, "stage": "", "until": Board.until, "at_most": MAX_TEXT_LOGS} | changes
    return list(results.session.scalars(_newest_text_logs(), named))


def test_text_logs_are_shown_newest_first_and_as_they_were_evaluated_last(results: Results) -> None:
    kind = SubmissionKind.TEXT_LOG
    first, second = results.add("A", 10, minute=1, kind=kind), results.add("B", 20, minute=2, kind=kind)
    again = results.add("A", 5, minute=1, kind=kind, finished_at=UNTIL)
    results.change(again, submission_id=first.submission_id)
    results.add("C", 30, minute=3, kind=SubmissionKind.LOG)
    results.add("D", 30, minute=3, kind=kind, track="track_2")
    results.add("E", 30, minute=3, kind=kind, stage="final")
    assert newest_text_logs(results) == [second.id, again.id]
    assert newest_text_logs(results, until=UNTIL - timedelta(seconds=1)) == [second.id, first.id]
    assert newest_text_logs(results, until=UNTIL) == [second.id, again.id]
    assert newest_text_logs(results, at_most=1) == [second.id]
    assert len(newest_text_logs(results, stage="final")) == len(newest_text_logs(results, track="track_2")) == 1


def test_a_history_has_comparable_results_only_newest_first(results: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = results.add("Ours", 10, minute=5)
    older, newer = results.add("Ours", 20, minute=1), results.add("Ours", 30, minute=9)
    results.add("Theirs", 40)
    results.add("Ours", 50, task=LOCK)
    for changes in ({"track": "track_2"}, {"stage": "final"}, {"kind": SubmissionKind.LOG}, {"evaluator_version": OLD}):
        results.add("Ours", 60, **changes)
    team = results.teams["Ours"]
    ours = Principal(role=Role.TEAM, team_id=team.id, team_name=team.name, leads_team=True)
    expected = [one.submission_id for one in (newer, shown, older)]
    assert [result.submission_id for result in past_results(results.session, ours, shown)] == expected
    monkeypatch.setattr(history, "MAX_RESULTS", 2)
    assert [result.submission_id for result in past_results(results.session, ours, shown)] == expected[:2]
    results.change(shown, stage="final")
    assert [result.success_rate for result in past_results(results.session, ours, shown)] == [0.1, 0.6]
