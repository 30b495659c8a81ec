import json
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import psycopg
import pytest
from service_factories import (
    LOCK,
    TASK,
    make_principal,
    make_record,
    make_score,
    play,
    play_all,
    shard_ids,
    submit,
    submit_scored,
)
from sqlalchemy import func, select, text
from sqlalchemy.exc import DBAPIError
from structlog.testing import capture_logs
from vitac.server.db.engine import Database
from vitac.server.db.models import Evaluation, ReceiptKey, ReceiptRow
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE
from vitac.server.receipts import chain
from vitac.server.receipts.chain import chain_state, ensure_key, links, receipts_of_submission
from vitac.server.submissions import runs
from vitac.server.submissions.receipts import issue_older


def test_a_final_result_gets_a_receipt_with_what_the_submission_shows(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session), tasks=(TASK, LOCK))
    play_all(database, submission)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        (receipt,) = receipts_of_submission(session, submission.id)
        receipt.require_valid(chain_state(session).public_key)
        result = receipt.result
        assert (result.evaluation, result.submission_digest) == (evaluation.id, submission.digest)
        assert (result.result_hash, result.evaluator_version) == (evaluation.result_hash, evaluation.evaluator_version)
        assert [(task.task, task.successes) for task in result.tasks] == [(TASK, 270), (LOCK, 160)]
        assert result.combined is not None
        assert result.combined.success_rate == 1.0
        assert result.finished_at == evaluation.finished_at
        stored = session.scalars(select(ReceiptRow.result)).one()
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
    assert second.link.previous == first.link.digest
    assert second.result.result_hash == first.result.result_hash


def test_results_that_end_at_once_make_one_chain_without_a_gap(database: Database) -> None:
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
        found = links(session)
        assert chain_state(session).receipts == teams
        assert session.scalar(select(func.count()).select_from(ReceiptKey)) == 1
        assert links(session, after=2, limit=2) == found[2:]
    assert [link.number for link in found] == list(range(1, teams + 1))
    assert found[0].previous is None
    assert all(link.previous == before.digest for before, link in pairwise(found))


def test_a_result_that_is_not_stored_leaves_no_gap(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that is killed at the last moment: its transaction never was."""
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        *others, last = shard_ids(session, submission)
    for shard_id in others:
        play(database, shard_id)

    def issue_and_die(*arguments: object) -> None:
        chain.issue(*arguments)  # type: ignore[arg-type]
        raise KeyboardInterrupt

    monkeypatch.setattr(lifecycle, "issue", issue_and_die)
    with pytest.raises(KeyboardInterrupt):
        play(database, last)
    monkeypatch.undo()
    with database.transaction() as session:
        assert chain_state(session).receipts == 0
        session.execute(text("UPDATE shards SET state = 'queued', lease_expires_at = NULL WHERE state = 'running'"))
    play(database, last)
    with database.transaction() as session:
        assert [link.number for link in links(session)] == [1]


def test_the_database_refuses_to_change_the_chain(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
    play_all(database, submission)
    for statement in (
        "UPDATE receipts SET result = ''",
        "DELETE FROM receipts",
        "TRUNCATE receipts",
        "DELETE FROM evaluations",
    ):
        with pytest.raises(DBAPIError), database.transaction() as session:
            session.execute(text(statement))
    copy = "INSERT INTO receipts SELECT {}, {}, {}, digest, result, result_sha256, public_key, signature FROM receipts"
    with pytest.raises(DBAPIError, match="does not follow") as caught, database.transaction() as session:
        session.execute(text(copy.format("number + 2", "evaluation_id", "digest")))
    assert isinstance(caught.value.orig, psycopg.errors.CheckViolation)


def test_older_results_get_theirs_in_the_order_in_which_they_ended(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        older = [submit_scored(session, team, name, {TASK: make_score(50)}) for name in ("one", "two")]
        session.execute(text("UPDATE evaluations SET platform_class = 'linux-x86_64'"))
        ended = session.scalars(select(Evaluation.submission_id).order_by(Evaluation.finished_at)).all()
    with database.transaction() as session:
        ensure_key(session)
    with database.transaction() as session:
        assert issue_older(session) == 2
        assert issue_older(session) == 0
        numbers = {each.id: receipts_of_submission(session, each.id)[0].link.number for each in older}
    assert [numbers[submission] for submission in ended] == [1, 2]


def test_an_older_result_that_cannot_be_read_does_not_stop_the_others(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        names = ("of a track that is gone", "without its tasks", "without its scores' fields", "whole")
        gone, unknown, odd, whole = [submit_scored(session, team, name, {TASK: make_score(50)}) for name in names]
        session.execute(text("SET LOCAL session_replication_role = replica"))
        session.execute(text("UPDATE evaluations SET platform_class = 'linux-x86_64'"))
        for each in (gone, unknown):
            session.execute(text("UPDATE submissions SET track = 'gone' WHERE id = :id"), {"id": each.id})
        session.execute(
            text("UPDATE evaluations SET counted_tasks = NULL WHERE submission_id = :id"), {"id": unknown.id}
        )
        session.execute(text("UPDATE evaluations SET scores = '[{}]' WHERE submission_id = :id"), {"id": odd.id})
    with database.transaction() as session:
        ensure_key(session)
    with database.transaction() as session, capture_logs() as logs:
        assert issue_older(session) == 3
        assert issue_older(session) == 0
        combined = receipts_of_submission(session, gone.id)[0].result.combined
        assert combined is not None
        assert combined.success_rate == 0.25, "half of one of the two tasks that counted"
        assert receipts_of_submission(session, unknown.id)[0].result.combined is None
        assert len(receipts_of_submission(session, whole.id)) == 1
        assert receipts_of_submission(session, odd.id) == []
    assert [line["event"] for line in logs] == 2 * ["receipt_left_out"]
    assert logs[0]["kind"] == "KeyError"


def test_a_receipt_that_was_taken_away_is_not_issued_again(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
    play_all(database, submission, record_of=make_record)
    with database.transaction() as session:
        session.execute(text("SET session_replication_role = replica"))
        session.execute(text("DELETE FROM receipts"))
    with database.transaction() as session:
        assert issue_older(session) == 0
        assert receipts_of_submission(session, submission.id) == []
