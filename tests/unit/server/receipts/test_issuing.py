import json
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta

import psycopg
import pytest
from service_factories import (
    LOCK,
    TASK,
    make_principal,
    play,
    play_all,
    shard_ids,
    submit,
)
from sqlalchemy import select, text
from sqlalchemy.exc import DBAPIError
from vitac.server.database.engine import Database
from vitac.server.database.models import ReceiptRow
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE
from vitac.server.receipts import issuing
from vitac.server.receipts.issuing import list_entries, receipt_of_arrival, receipts_of_submission
from vitac.server.receipts.receipt import End
from vitac.server.submissions import runs
from vitac.server.transparency.log import append, count_entries, read_log_state, read_tree
from vitac.server.transparency.merkle import make_tree


def test_a_final_result_gets_a_receipt_with_what_the_submission_shows(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session), tasks=(TASK, LOCK))
    play_all(database, submission)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        (receipt,) = receipts_of_submission(session, submission.id)
        receipt.require_valid(read_log_state(session).public_key)
        result = receipt.result
        assert (result.evaluation, result.submission_digest) == (evaluation.id, submission.digest)
        assert (result.result_hash, result.evaluator_version) == (evaluation.result_hash, evaluation.evaluator_version)
        assert [(task.task, task.successes) for task in result.tasks] == [(TASK, 270), (LOCK, 160)]
        assert result.combined is not None
        assert result.combined.success_rate == 1.0
        assert result.finished_at == evaluation.finished_at
        stored = session.scalars(select(ReceiptRow.content).where(ReceiptRow.stands_for == "result")).one()
        arrival = receipt_of_arrival(session, submission.id)
        assert arrival is not None
        assert (arrival.entry.number, receipt.entry.number) == (1, 2)
        assert arrival.submission.submitted_at == result.submitted_at
        assert arrival.submission.submission_digest == result.submission_digest
        assert list_entries(session) == [arrival.entry, receipt.entry]
    assert set(json.loads(stored)) == set(type(result).model_fields)
    assert "outcome" not in stored, "nothing of single episodes"


def test_a_second_run_gets_a_second_receipt(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
    play_all(database, submission)
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
    play_all(database, submission)
    with database.transaction() as session:
        first, second = receipts_of_submission(session, submission.id)
    assert (first.result.run, second.result.run) == (1, 2)
    assert second.result.result_hash == first.result.result_hash


def test_results_that_end_at_once_make_one_log_without_a_gap(database: Database) -> None:
    teams = 4
    with database.transaction() as session:
        made = [submit(session, make_principal(session, f"Team {number}"), str(number)) for number in range(teams)]
        shards = {submission.id: shard_ids(session, submission) for submission in made}
    for ids in shards.values():
        for shard_id in ids[:-1]:
            play(database, shard_id)
    with ThreadPoolExecutor(teams) as pool:
        list(pool.map(lambda ids: play(database, ids[-1]), shards.values()))
    with database.transaction() as session:
        found = list_entries(session)
        assert count_entries(session) == 2 * teams
        assert list_entries(session, after=2, limit=2) == found[2:4]
        assert read_tree(session).root() == make_tree([entry.leaf_hash for entry in found]).root()
    assert [entry.number for entry in found] == list(range(1, 2 * teams + 1))


def test_a_result_that_is_not_stored_leaves_no_gap(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that is killed at the last moment: its transaction never was."""
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        *others, last = shard_ids(session, submission)
    for shard_id in others:
        play(database, shard_id)

    def issue_and_die(*arguments: object) -> None:
        issuing.issue_for_result(*arguments)  # type: ignore[arg-type]
        raise KeyboardInterrupt

    monkeypatch.setattr(lifecycle, "issue_for_result", issue_and_die)
    with pytest.raises(KeyboardInterrupt):
        play(database, last)
    monkeypatch.undo()
    with database.transaction() as session:
        assert count_entries(session) == 1, "that of the submission"
        session.execute(
            text("UPDATE work SET state = 'queued', lease_expires_at = NULL, worker_id = NULL WHERE state = 'running'")
        )
    play(database, last)
    with database.transaction() as session:
        assert [entry.number for entry in list_entries(session)] == [1, 2]


def test_the_database_refuses_to_change_the_log(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
    play_all(database, submission)
    for statement in (
        "UPDATE receipts SET content = ''",
        "DELETE FROM receipts",
        "TRUNCATE receipts",
        "TRUNCATE tree_nodes",
        "TRUNCATE cosignatures",
        "DELETE FROM evaluations",
    ):
        with pytest.raises(DBAPIError), database.transaction() as session:
            session.execute(text(statement))
    columns = [column.name for column in ReceiptRow.__table__.columns if column.name != "number"]
    copy = f"INSERT INTO receipts (number, {', '.join(columns)}) SELECT number + 3, {', '.join(columns)} FROM receipts"  # noqa: S608 - names of our own columns
    with pytest.raises(DBAPIError, match="does not follow") as caught, database.transaction() as session:
        session.execute(text(copy))
    assert isinstance(caught.value.orig, psycopg.errors.CheckViolation)


def test_a_clock_that_is_set_back_does_not_break_the_order(database: Database) -> None:
    """The clock of a server plays no part, and the database's own may be set back."""
    with database.transaction() as session:
        team = make_principal(session)
        submit(session, team, "one")
        (first,) = list_entries(session)
        later = first.issued_at + timedelta(hours=1)
        append(session, lambda at: _ended(max(at, later)))
        submit(session, team, "two")
        _, ended, second = list_entries(session)
    assert first.issued_at < ended.issued_at == second.issued_at == later


def _ended(at: datetime) -> End:
    """The end of some competition."""
    return End(issued_at=at, competition="cup", finalized_at=at, reason=None, winners=(), judged=())


def test_the_same_content_sent_twice_arrives_once(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        assert submit(session, team).id == submit(session, team).id
        assert count_entries(session) == 1
