"""What is read of the tables behind the boards is kept exactly until one of them changes."""

from collections.abc import Callable

import pytest
from databases import copied_database
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardChange, BoardResult, Evaluation, LogCopy, Submission, Team
from vitac.server.leaderboards import board_cache
from vitac.server.leaderboards.best_entries import Board, places
from vitac.server.leaderboards.board_cache import forget_old_notes, kept_until_change
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard

from competitions import shown_stage

Change = Callable[[Session], object]


class Reader:
    """Counts how often it reads."""

    def __init__(self) -> None:
        self.reads = 0

    def in_(self, session: Session, key: str = "board") -> int:
        def read() -> int:
            self.reads += 1
            return self.reads

        return kept_until_change(session, (id(self), key), read)


@pytest.fixture
def scored(database: Database) -> Database:
    with database.transaction() as session:
        for name, successes in (("Ants", 50), ("Bees", 70)):
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
    return database


def test_a_copy_of_a_database_has_values_of_its_own(scored: Database) -> None:
    reader = Reader()
    scored.dispose()
    with copied_database(scored.address) as copy, copy.transaction() as of_copy, scored.transaction() as session:
        assert [reader.in_(session), reader.in_(of_copy)] == [1, 2]
        assert [reader.in_(session), reader.in_(of_copy)] == [1, 2]


def add_a_result(session: Session) -> None:
    submit_scored(session, make_principal(session, "Cats"), "cats", {TASK: make_score(90)})


def add_a_copy(session: Session) -> None:
    copied, earlier = session.scalars(select(Evaluation)).all()
    values = {"evaluation_id": copied.id, "earlier_submission_id": earlier.submission_id, "episodes": 3}
    session.execute(insert(LogCopy).values(values))


@pytest.mark.parametrize(
    "change",
    [
        add_a_result,
        add_a_copy,
        lambda session: session.execute(delete(BoardResult)),
        lambda session: session.execute(update(BoardResult).values(is_copy=True)),
        lambda session: session.execute(update(Submission).values(team_id=Submission.team_id)),
        lambda session: session.execute(update(Team).values(name=Team.name + "2", name_key=Team.name_key + "2")),
        lambda session: session.execute(
            update(Team).values(disqualified_at=func.now(), disqualified_for="two accounts")
        ),
    ],
)
def test_each_change_of_what_boards_show_is_seen_by_who_sees_the_change(scored: Database, change: Change) -> None:
    reader = Reader()
    with scored.transaction() as session:
        assert [reader.in_(session), reader.in_(session), reader.in_(session, "another board")] == [1, 1, 2]
    with scored.transaction() as changing, scored.transaction() as other:
        change(changing)
        changing.flush()
        assert [reader.in_(changing), reader.in_(changing)] == [3, 3]
        assert reader.in_(other) == 1, "it sees what was before"
    with scored.transaction() as session:
        assert reader.in_(session) == 3


def test_a_change_that_is_taken_back_leaves_what_was_kept(scored: Database) -> None:
    reader = Reader()
    with scored.transaction() as session:
        assert reader.in_(session) == 1
    with scored.transaction() as session:
        add_a_result(session)
        assert reader.in_(session) == 2
        session.rollback()
    with scored.transaction() as session:
        assert reader.in_(session) == 1


def test_a_new_version_of_the_evaluator_reads_anew(scored: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    reader = Reader()
    with scored.transaction() as session:
        assert reader.in_(session) == 1
        monkeypatch.setattr(board_cache, "evaluator_version", lambda: "another")
        assert reader.in_(session) == 2


def test_what_concerns_no_board_is_not_noted(scored: Database) -> None:
    with scored.transaction() as session:
        before = session.scalars(select(BoardChange.id)).all()
        make_principal(session, "Cats")
        session.execute(update(Submission).values(name="another"))
        session.execute(update(Team).values(contact="ann@example.org"))
        assert session.scalars(select(BoardChange.id)).all() == before


def test_boards_and_places_follow_a_disqualification_and_a_new_best_result(scored: Database) -> None:
    def shown() -> list[list[str]]:
        with scored.transaction() as session:
            found = places(session, Board(track=TRACK))[TASK]
            names = {submission: session.get_one(Submission, submission).name for submission in found}
            ranked = sorted(found, key=lambda submission: found[submission].rank)
            assert {place.of for place in found.values()} <= {len(found)}
            log_boards(session, shown_stage(session, TRACK))
            return [
                [
                    entry.submission_name
                    for entry in leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
                ],
                [names[submission] for submission in ranked],
            ]

    assert shown() == [["Bees", "Ants"]] * 2
    with scored.transaction() as session:
        add_a_result(session)
    assert shown() == [["cats", "Bees", "Ants"]] * 2
    with scored.transaction() as session:
        bees = update(Team).where(Team.name == "Bees")
        session.execute(bees.values(disqualified_at=func.now(), disqualified_for="two accounts"))
    assert shown() == [["cats", "Ants"]] * 2


def test_of_old_notes_only_the_newest_stay_and_the_next_change_is_seen(
    scored: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board_cache, "NOTES_KEPT", 2)
    reader = Reader()
    with scored.transaction() as session:
        newest = session.scalar(select(func.max(BoardChange.id))) or 0
        forget_old_notes(session)
        assert session.scalars(select(BoardChange.id).order_by(BoardChange.id)).all() == [newest - 1, newest]
        assert reader.in_(session) == 1
        forget_old_notes(session)
        assert reader.in_(session) == 1
        add_a_result(session)
        assert reader.in_(session) == 2
