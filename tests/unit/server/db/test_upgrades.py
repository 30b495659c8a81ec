"""Databases that were made at an older revision and hold data show the same after an upgrade."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import psycopg
import pytest
from alembic import command
from databases import copied_database, fresh_database
from psycopg import sql
from service_factories import (
    LOCK,
    TASK,
    TRACK,
    forget_boards,
    make_principal,
    make_score,
    make_settings,
    play,
    shard_ids,
    submit,
)
from service_factories import submit_scored as scored
from sqlalchemy import select
from vitac.server.db import schema
from vitac.server.db.engine import Database
from vitac.server.db.models import Submission
from vitac.server.db.schema import downgrade, installed_revision, is_current, newest_revision, upgrade
from vitac.server.evaluations import lifecycle
from vitac.server.leaderboards import standings
from vitac.server.principals import CONSOLE
from vitac.server.submissions import listing

OLDER = sorted(schema._revisions() - {newest_revision()})
TABLES = """
    SELECT table_name, array_agg(column_name::text ORDER BY column_name) FROM information_schema.columns
    WHERE table_schema = 'public' AND is_generated = 'NEVER' AND table_name !~ '^(procrastinate|alembic)'
    GROUP BY table_name ORDER BY table_name
"""
COUNTERS = """
    SELECT table_name, column_name FROM information_schema.columns
    WHERE table_schema = 'public' AND is_identity = 'YES' AND table_name !~ '^(procrastinate|alembic)'
"""


@pytest.fixture(scope="module")
def filled() -> Iterator[str]:
    """A database of today with boards, and submissions in several states."""
    with fresh_database() as address:
        database = Database(address)
        with database.transaction() as session:
            teams = [make_principal(session, f"Team {letter}") for letter in "ABC"]
            scored(session, teams[0], "one task", {TASK: make_score(50)})
            scored(session, teams[0], "both tasks", {TASK: make_score(50), LOCK: make_score(100)})
            scored(session, teams[1], "nothing met", {TASK: make_score(0, mean_steps=None)})
            running = submit(session, teams[1], "half played")
            submit(session, teams[2], "waits")
            shards = shard_ids(session, running)
        play(database, shards[0])
        database.dispose()
        yield address


@pytest.fixture(scope="module")
def shown_today(filled: str) -> dict[str, Any]:
    database = Database(filled)
    found = shown(database)
    database.dispose()
    return found


@pytest.fixture(scope="module")
def fallen_to(filled: str, shown_today: dict[str, Any]) -> Iterator[Callable[[str], Database]]:
    """Gives a copy of it at a revision: asked for from the newest to the oldest, each step is made once."""
    with ExitStack() as stack:
        copies: list[tuple[str, Database]] = []

        def at(revision: str) -> Database:
            if not copies or copies[-1][0] < revision:
                copies.append((revision, stack.enter_context(copied_database(filled))))
            fallen = copies[-1][1]
            downgrade(fallen, revision)
            copies[-1] = (revision, fallen)
            return fallen

        yield at


@pytest.fixture(scope="module")
def born_at() -> Iterator[dict[str, Database]]:
    """Databases with the tables as each older revision had them; each step is made once."""
    with ExitStack() as stack:
        newest = Database(stack.enter_context(fresh_database("template0")))
        born = {}
        for revision in OLDER:
            make_at(newest, revision)
            newest.dispose()
            born[revision] = stack.enter_context(copied_database(newest.address))
        yield born


def test_revisions_are_given_in_any_order(fallen_to: Callable[[str], Database]) -> None:
    for revision in (OLDER[-2], OLDER[-1]):
        with fallen_to(revision).engine.connect() as connection:
            assert installed_revision(connection) == revision


@pytest.mark.parametrize("revision", OLDER[::-1])
def test_boards_and_submissions_are_the_same_after_an_upgrade(
    fallen_to: Callable[[str], Database], born_at: dict[str, Database], shown_today: dict[str, Any], revision: str
) -> None:
    born = born_at[revision]
    copy_rows(fallen_to(revision).address, born.address)
    upgrade(born)
    assert is_current(born)
    assert shown(born) == shown_today
    with born.transaction() as session:
        submit(session, make_principal(session, "Team D"), "new")
    born.dispose()


def test_coefficients_get_the_evaluations_that_are_known_to_have_learned_them(filled: str) -> None:
    """Not where there are others, which another sensor or evaluator may have made, nor while an evaluation runs."""
    put = "INSERT INTO submission_files SELECT id, %s, %s, 1, 'file', %s FROM submissions WHERE name = ANY(%s)"
    told = """
        SELECT submissions.name, facts, evaluations.id::text FROM submission_files AS files
        JOIN submissions ON submissions.id = files.submission_id JOIN evaluations USING (submission_id)
        WHERE role = 'coefficients' ORDER BY 1, sha256
    """
    everywhere = ["one task", "both tasks", "nothing met"]
    with copied_database(filled) as database:
        with database.transaction() as session:
            played_again = session.scalars(select(Submission).where(Submission.name == "nothing met")).one()
            lifecycle.start(session, played_again, 2)
        downgrade(database, "0040")
        with psycopg.connect(database.address) as connection:
            connection.execute(put, ("sensor", 64 * "a", "{}", everywhere))
            connection.execute(put, ("coefficients", 64 * "b", '{"evaluator_version": "1"}', everywhere))
            connection.execute(put, ("coefficients", 64 * "c", "{}", ["both tasks"]))
        upgrade(database)
        with psycopg.connect(database.address) as connection:
            rows = connection.execute(told).fetchall()
        downgrade(database, "0040")
        with psycopg.connect(database.address) as connection:
            before = connection.execute(told).fetchall()
    assert [row[:2] for row in rows] == [
        ("both tasks", {}),
        ("both tasks", {}),
        ("nothing met", {}),
        ("nothing met", {}),
        ("one task", {rows[-1][2]: 64 * "a"}),
    ]
    assert [row[1] for row in before] == [{}] * 5


def test_results_keep_their_list_and_tasks_as_far_as_the_track_files_tell(filled: str) -> None:
    change = "UPDATE submissions SET {} WHERE name = %s"
    sealed = "UPDATE evaluations SET commitment = %s WHERE state = 'queued'"
    told = """
        SELECT CASE WHEN state = 'completed' THEN name ELSE state END, list_kind, counted_tasks
        FROM evaluations JOIN submissions ON submissions.id = submission_id
    """
    listed = "INSERT INTO sealed_lists (commitment, track, stage, secret) VALUES (%s, 'track_1', 'one', %s)"
    with copied_database(filled) as database:
        with psycopg.connect(database.address) as connection:
            before = {name: kept for name, *kept in connection.execute(told)}
        downgrade(database, "0041")
        with psycopg.connect(database.address) as connection:
            connection.execute(change.format("track = 'gone'"), ["one task"])
            connection.execute(change.format("tasks = tasks || '{gone}'"), ["nothing met"])
            connection.execute(change.format("kind = 'log', track = 'gone'"), ["both tasks"])
            connection.execute(listed, [64 * "c", 64 * "5"])
            connection.execute(sealed, [64 * "c"])
        upgrade(database)
        with psycopg.connect(database.address) as connection:
            after = {name: kept for name, *kept in connection.execute(told)}
    combined = [TASK, LOCK]
    assert before == {
        "one task": ["public", combined],
        "both tasks": ["public", combined],
        "nothing met": ["public", combined],
        "running": ["public", None],
        "queued": ["public", None],
    }
    assert after == before | {
        "one task": [None, None],
        "both tasks": [None, combined],
        "nothing met": [None, combined],
        "queued": ["sealed", None],
    }


def make_at(database: Database, revision: str) -> None:
    """Makes the tables as that revision had them."""
    with schema._migrating(database, 5.0, 60.0) as connection:
        command.upgrade(schema._configuration(connection), revision)


def copy_rows(source: str, target: str) -> None:
    """Copies all rows but those of the queue, which are made again; to the columns as the target has them."""
    with psycopg.connect(source) as old, psycopg.connect(target) as born:
        tables = born.execute(TABLES).fetchall()
        assert tables == old.execute(TABLES).fetchall()
        born.execute("SET session_replication_role = replica")  # no foreign keys and triggers meanwhile
        for table, columns in tables:
            born.execute(sql.SQL("DELETE FROM {}").format(sql.Identifier(table)))  # a migration may have written some
            names = sql.SQL(", ").join(map(sql.Identifier, columns))
            rows = sql.SQL("COPY {} ({}) {}").format(sql.Identifier(table), names, sql.SQL("TO STDOUT"))
            place = sql.SQL("COPY {} ({}) {}").format(sql.Identifier(table), names, sql.SQL("FROM STDIN"))
            with old.cursor().copy(rows) as read, born.cursor().copy(place) as write:
                for data in read:
                    write.write(data)
        for table, column in born.execute(COUNTERS).fetchall():
            numbers = sql.SQL("SELECT setval(pg_get_serial_sequence(%s, %s), max({}) + 1) FROM {}")
            born.execute(numbers.format(sql.Identifier(column), sql.Identifier(table)), [table, column])


def shown(database: Database) -> dict[str, Any]:
    """What people see: all boards and submissions, without times that pass."""
    forget_boards()
    with database.transaction() as session:
        boards = [standings.leaderboard(session, TRACK, task=task).view for task in (None, TASK, LOCK)]
        found = listing.list_submissions(session, make_settings(), CONSOLE).items
        episodes = [listing.episodes(session, CONSOLE, submission.id) for submission in found]
    assert [board.teams for board in boards] == [2, 2, 1]
    assert len(found) == 5
    assert sum(map(len, episodes)) > 0
    return {
        "boards": [board.model_dump(mode="json", exclude={"generated_at"}) for board in boards],
        "submissions": [submission.model_dump(mode="json", exclude={"workers"}) for submission in found],
        "episodes": [[episode.model_dump(mode="json") for episode in of_one] for of_one in episodes],
    }
