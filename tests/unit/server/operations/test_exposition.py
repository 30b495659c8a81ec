from collections.abc import Mapping
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from service_factories import make_principal, make_settings, submit
from sqlalchemy import event, update
from vitac.server.db.engine import Database
from vitac.server.db.models import Worker
from vitac.server.db.states import WorkerState
from vitac.server.metrics.totals import TotalsWriter
from vitac.server.operations.exposition import KEPT_S, Exposition
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore

Series = tuple[str, frozenset[tuple[str, str]]]


@pytest.fixture
def services(database: Database, tmp_path: Path) -> Services:
    settings = make_settings(state_dir=tmp_path)
    return Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def parsed(text: bytes) -> Mapping[Series, float]:
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text.decode())
        for sample in family.samples
    }


def value(text: bytes, name: str, **labels: str) -> float:
    return parsed(text)[(name, frozenset(labels.items()))]


def test_fresh_service_shows_zeros_rather_than_nothing(services: Services) -> None:
    text = Exposition(services).text()
    assert value(text, "vitac_database_up") == 1
    assert value(text, "vitac_shards", state="queued") == 0
    assert value(text, "vitac_shard_retries_total", reason="lease_expired") == 0
    assert value(text, "vitac_leases_lost_total") == 0
    assert value(text, "vitac_claim_seconds_bucket", le="+Inf") == 0
    assert value(text, "vitac_workers", state="lost") == 0
    assert value(text, "vitac_server_disk_free_bytes") > 0
    assert value(text, "process_resident_memory_bytes") > 0


def test_counts_of_other_processes_are_shown(services: Services) -> None:
    services.instruments.episodes.labels("peg-insertion").inc(5)
    services.instruments.requests_s.labels("GET", "/health", "2xx").observe(0.03)
    TotalsWriter(services.instruments).write(services.database)
    of_other = Services(settings=services.settings, database=services.database, blobs=services.blobs, postgres=None)
    text = Exposition(of_other).text()
    assert value(text, "vitac_episodes_total", task="peg-insertion") == 5
    labels = {"method": "GET", "route": "/health", "status": "2xx"}
    counts = [value(text, "vitac_request_seconds_bucket", **labels, le=le) for le in ("0.02", "0.05", "+Inf")]
    assert counts == [0, 1, 1]


def test_buckets_stand_in_the_order_of_their_bounds(services: Services) -> None:
    text = Exposition(services).text().decode()
    lines = [line for line in text.splitlines() if line.startswith("vitac_shard_wait_seconds_bucket")]
    bounds = [float(line.split('le="')[1].split('"')[0]) for line in lines]
    assert bounds == sorted(bounds)
    assert len(bounds) == 10


def test_scrapes_within_seconds_share_one_answer(services: Services) -> None:
    now = [0.0]
    exposition = Exposition(services, clock=lambda: now[0])
    assert value(exposition.text(), "vitac_shards", state="queued") == 0
    with services.database.transaction() as session:
        submit(session, make_principal(session))
    assert value(exposition.text(), "vitac_shards", state="queued") == 0
    now[0] = KEPT_S + 1
    assert value(exposition.text(), "vitac_shards", state="queued") > 0


def test_database_that_is_away_is_shown_as_such(services: Services) -> None:
    object.__setattr__(services, "database", Database("postgresql://nobody@/none?host=/nowhere"))
    text = Exposition(services).text()
    assert value(text, "vitac_database_up") == 0
    assert not [name for name, _ in parsed(text) if name.startswith("vitac_shards")]


def test_scrape_asks_the_database_as_often_for_many_rows_as_for_none(services: Services) -> None:
    asked: list[str] = []
    event.listen(
        services.database.engine, "before_cursor_execute", lambda _c, _cur, statement, *_: asked.append(statement)
    )
    Exposition(services).text()
    for_none = len(asked)
    with services.database.transaction() as session:
        principal = make_principal(session)
        for number in range(30):
            submit(session, principal, f"{number}")
        for pid in range(30):
            session.add(a_worker(pid))
    asked.clear()
    Exposition(services).text()
    assert len(asked) == for_none < 10


def a_worker(pid: int) -> Worker:
    return Worker(
        host=f"machine-{pid}", pid=pid, slots=1, state=WorkerState.READY, evaluator_version="1",
        platform_class="x86_64-linux", isolation="", disk_bytes=100, disk_free_bytes=pid,
    )  # fmt: skip


def test_disks_are_shown_by_host_for_workers_that_run(services: Services) -> None:
    with services.database.transaction() as session:
        session.add_all([a_worker(3), a_worker(4)])
    with services.database.transaction() as session:
        session.execute(update(Worker).where(Worker.pid == 4).values(state=WorkerState.STOPPED))
    text = Exposition(services).text()
    free = {labels for name, labels in parsed(text) if name == "vitac_worker_disk_free_bytes"}
    assert free == {frozenset({("host", "machine-3")})}
    assert value(text, "vitac_worker_disk_free_bytes", host="machine-3") == 3
    assert value(text, "vitac_worker_slots") == 1
