import threading
from collections.abc import Sequence

import pytest
from service_factories import make_record
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.server.queue.work import LeaseLost
from vitac.worker import shard_run
from vitac.worker.shard_run import RecordStore
from worker_fakes import eventually


class Database:
    """Remembers the episodes of each transaction; `lets_in` holds transactions up, `refuses` makes them fail."""

    def __init__(self) -> None:
        self.stored: list[list[int]] = []
        self.lets_in = threading.Event()
        self.lets_in.set()
        self.refuses = False
        self.given_up = threading.Event()

    def store(self, records: Sequence[EpisodeRecord]) -> None:
        self.lets_in.wait(120.0)
        if self.refuses:
            raise LeaseLost("Shard 1 is no longer held under token 1.")
        self.stored.append([record.episode for record in records])


@pytest.fixture
def database() -> Database:
    return Database()


@pytest.fixture
def store(database: Database) -> RecordStore:
    return RecordStore(database.store, give_up=database.given_up.set)


def test_records_that_come_within_a_moment_are_stored_together(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shard_run, "TOGETHER_S", 3600.0)
    store = RecordStore(database.store, give_up=database.given_up.set)
    for number in (1, 2, 3):
        store.add(make_record(number))
    store.close()
    assert database.stored == [[1, 2, 3]]


def test_record_that_stays_alone_is_stored_without_a_further_one(database: Database, store: RecordStore) -> None:
    store.add(make_record(1))
    eventually(lambda: database.stored == [[1]])
    store.close()
    assert database.stored == [[1]]


def test_records_that_come_while_the_database_is_busy_wait_and_none_is_lost(
    database: Database, store: RecordStore
) -> None:
    database.lets_in.clear()
    for number in range(1, 21):
        store.add(make_record(number))
    database.lets_in.set()
    store.close()
    assert [number for together in database.stored for number in together] == list(range(1, 21))


def test_closing_without_a_record_opens_no_transaction(database: Database, store: RecordStore) -> None:
    store.close()
    assert database.stored == []


def test_failure_ends_the_shard_at_once_and_is_raised_where_the_shard_is_run(
    database: Database, store: RecordStore
) -> None:
    database.refuses = True
    store.add(make_record(1))
    assert database.given_up.wait(120.0)
    store.add(make_record(2))
    with pytest.raises(LeaseLost, match="no longer held"):
        store.close()
    assert database.stored == []
