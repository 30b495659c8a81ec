import json
from threading import Thread

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError
from vitac.server.database.engine import Database
from vitac.server.database.metrics import Instruments, RetryReason, SeriesKey, TotalsWriter, list_samples, totals

EPISODES = SeriesKey("vitac_episodes_total", '{"task": "peg-insertion"}')


def read(database: Database) -> dict[SeriesKey, float]:
    with database.transaction() as session:
        return totals(session)


def test_totals_are_those_of_all_processes_however_often_each_writes(database: Database) -> None:
    for _process in range(2):
        instruments = Instruments()
        writer = TotalsWriter(instruments)
        for count in (3, 0, 4):
            instruments.episodes.labels("peg-insertion").inc(count)
            writer.write(database)
    assert read(database)[EPISODES] == 14


def test_series_that_are_new_are_there_at_zero_and_unchanged_ones_are_left_alone(database: Database) -> None:
    instruments = Instruments()
    writer = TotalsWriter(instruments)
    writer.write(database)
    assert set(read(database).values()) == {0.0}
    with database.transaction() as session:
        session.execute(text("DELETE FROM metric_totals"))
    instruments.leases_lost.inc()
    writer.write(database)
    assert read(database) == {SeriesKey("vitac_leases_lost_total"): 1}


def test_histograms_add_up_by_bucket(database: Database) -> None:
    for waited_s in (0.1, 3.0):
        instruments = Instruments()
        instruments.shard_wait_s.observe(waited_s)
        TotalsWriter(instruments).write(database)
    found = {key.label_values()["le"]: value for key, value in read(database).items() if key.name.endswith("_bucket")}
    assert (found["0.05"], found["0.2"], found["5.0"], found["+Inf"]) == (0, 1, 2, 2)
    assert read(database)[SeriesKey("vitac_shard_wait_seconds_sum")] == pytest.approx(3.1)


def test_counts_wait_for_a_database_that_is_away(database: Database) -> None:
    instruments = Instruments()
    writer = TotalsWriter(instruments)
    instruments.episodes.labels("peg-insertion").inc()
    with pytest.raises(DBAPIError):
        writer.write(Database("postgresql://nobody@/none?host=/nowhere"))
    instruments.episodes.labels("peg-insertion").inc()
    writer.write(database)
    assert read(database)[EPISODES] == 2


def test_processes_that_write_at_the_same_time_lose_nothing_and_do_not_block_each_other(database: Database) -> None:
    def count() -> None:
        instruments = Instruments()
        writer = TotalsWriter(instruments)
        for number in range(20):
            instruments.shard_retries.labels(list(RetryReason)[number % 3]).inc()
            instruments.claim_s.observe(0.001 * number)
            writer.write(database)

    threads = [Thread(target=count) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    found = read(database)
    assert found[SeriesKey("vitac_claim_seconds_count")] == 80
    assert sum(value for key, value in found.items() if key.name == "vitac_shard_retries_total") == 80


def test_samples_carry_no_times_of_creation_and_labels_in_one_order() -> None:
    instruments = Instruments()
    instruments.requests_s.labels("GET", "/health", "2xx").observe(0.001)
    found = list_samples(instruments)
    assert not [key for key in found if key.name.endswith("_created")]
    assert all(key.labels == json.dumps(key.label_values(), sort_keys=True) for key in found)
