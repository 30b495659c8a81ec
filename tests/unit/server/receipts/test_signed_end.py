"""Winners, prizes and marks are changed in the database after the end of a competition, and the export is audited."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from audited_boards import complete, environment_of
from databases import opened_database
from obstore.store import MemoryStore
from service_factories import TASK, TRACK, forget_boards, make_principal, own_record, submit
from sqlalchemy import text
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.server.database.engine import Database
from vitac.server.decisions.exporting import export_receipts
from vitac.server.decisions.finishing import finalize
from vitac.server.decisions.judging import give_marks
from vitac.server.principals import CONSOLE
from vitac.server.receipts.audit import audit
from vitac.server.storage.blobs import BlobStore

from competitions import make_competition, moved, open_now, put_in_place, shown_stage

TEAMS = ("Ants", "Bees", "Cats")
PRIZES = [{"place": "first", "amount": 2000, "winners": 1}, {"place": "second", "amount": 1000, "winners": 2}]
JUDGING = {
    "criteria": [{"name": "structure", "title": "The structure"}],
    "judges_at_least": 1,
    "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
}


def judged_cup() -> dict[str, Any]:
    """A competition of one stage that judges decide with."""
    content = make_competition(prizes=PRIZES)
    del content["tracks"][TRACK]["stages"][1]
    content["tracks"][TRACK]["judging"] = JUDGING
    return content


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    """A competition with its winners: the Cats failed most often, and the judges liked them best."""
    with opened_database() as database:
        env = environment_of(TASK)
        with database.transaction() as session:
            put_in_place(session, open_now(judged_cup()))
            submissions = [submit(session, make_principal(session, team), team) for team in TEAMS]
        for n_failed, submission in enumerate(submissions):

            def record_of(_task: str, number: int, team: int = n_failed) -> EpisodeRecord:
                has_failed = number <= 5 * team
                return own_record(
                    100 * team + 100, number, EpisodeOutcome.TACTILE if has_failed else EpisodeOutcome.SUCCESS
                )

            complete(database, submission, env, record_of)
        with database.transaction() as session:
            put_in_place(session, moved(judged_cup(), days=-3650))
            for mark, submission in enumerate(submissions, start=5):
                give_marks(session, CONSOLE, submission.id, {"structure": float(mark)}, judge="X")
            assert [winner.team for winner in finalize(session, CONSOLE)] == ["Cats", "Bees", "Ants"]
        yield database


def findings(database: Database, folder: Path, *statements: str) -> list[str]:
    """What an audit finds after changes by somebody who has the database; they are taken back."""
    forget_boards()
    with Session(database.engine) as session:
        session.execute(text("SET LOCAL session_replication_role = replica"))  # no triggers, no foreign keys
        for statement in statements:
            session.execute(text(statement))
        session.expire_all()
        export_receipts(session, BlobStore(MemoryStore()), folder / "board.zip", shown_stage(session, TRACK))
    return audit(folder / "board.zip", episodes=0).findings


def test_an_untouched_end_is_found_right(database: Database, tmp_path: Path) -> None:
    assert findings(database, tmp_path) == []


OTHER_WINNERS = "The winners and prizes of the export are not those of receipt 8."
OTHER_MARKS = "The judges' marks of the export are not those of receipt 8."


@pytest.mark.parametrize(
    ("statement", "expected"),
    [
        ("UPDATE competition SET winners = jsonb_set(winners, '{0,amount}', '9000')", OTHER_WINNERS),
        ("UPDATE competition SET winners = jsonb_set(winners, '{0,team}', '\"Dogs\"')", OTHER_WINNERS),
        ("UPDATE competition SET winners = jsonb_set(winners, '{1,place}', '\"first\"')", OTHER_WINNERS),
        (
            "UPDATE competition SET winners = jsonb_build_array(winners -> 1, winners -> 0, winners -> 2)",
            "The ranks of the winners do not count from 1.",
        ),
        ("UPDATE competition SET winners = winners - 0", OTHER_WINNERS),
        ("UPDATE judging_marks SET mark = 10 WHERE mark = 5", OTHER_MARKS),
        ("DELETE FROM judging_marks WHERE mark = 7", OTHER_MARKS),
        ("DELETE FROM receipts WHERE number = 8", "which has no end of the competition"),
        ("UPDATE receipts SET content = replace(content, '2000', '2001') WHERE number = 8", "receipt 8 was changed"),
    ],
)
def test_other_winners_prizes_or_marks_than_the_signed_ones_are_found(
    database: Database, tmp_path: Path, statement: str, expected: str
) -> None:
    found = findings(database, tmp_path, statement)
    assert any(expected in finding for finding in found), found
