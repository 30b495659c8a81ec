from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from prometheus_client.parser import text_string_to_metric_families
from service_factories import make_principal, make_settings, submit
from sqlalchemy import event
from vitac.server.database.engine import Database
from vitac.server.database.metrics import TotalsWriter
from vitac.server.database.models import Worker
from vitac.server.database.states import WorkerState
from vitac.server.operations.exposition import KEPT_S, LOST, Exposition, server_families, state_families
from vitac.server.queue.workers import Disk
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.views.operations import CountsView, OperationsView, QueueView, StorageView, WorkerView

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
    assert len(asked) == for_none <= 11


def a_worker(pid: int) -> Worker:
    return Worker(
        host=f"machine-{pid}", pid=pid, slots=1, state=WorkerState.READY, evaluator_version="1",
        platform_class="x86_64-linux", isolation="", disk_bytes=100, disk_free_bytes=pid,
    )  # fmt: skip


AT = datetime(2026, 3, 1, tzinfo=UTC)


def seen_worker(host: str, state: WorkerState = WorkerState.READY, *, lost: bool = False, **changes: Any) -> Any:
    """A worker of the last hour with two slots and a disk."""
    values = {
        "id": uuid4(), "host": host, "pid": 1, "slots": 2, "state": state, "message": "", "isolation": "",
        "evaluator_version": "1+a", "families": [], "platform_class": "x86_64-linux", "started_at": AT,
        "heartbeat_at": AT, "disk_bytes": 100, "disk_free_bytes": 40, "is_lost": lost, "worker_order": "work",
        "shards": [], "has_gpu": False,
    }  # fmt: skip
    return WorkerView.model_validate(values | changes)


def a_state(*workers: Any, **queue: Any) -> OperationsView:
    nothing = {
        "shards_queued": 0, "shards_running": 0, "oldest_shard_s": None, "shard_idle_s": None, "evaluations_queued": 0,
        "evaluations_running": 0, "oldest_evaluation_s": None, "evaluations_unserved": 0,
    }  # fmt: skip
    return OperationsView(
        queue=QueueView.model_validate(nothing | queue),
        storage=StorageView(uploads=3, uploads_bytes=4000, database_bytes=50_000),
        workers=list(workers),
        episodes_in_5_minutes=7,
        counts=CountsView(
            episodes=0, shards_finished=0, shard_retries=0, shards_given_up=0, leases_lost=0, requests=0,
            requests_failed=0, requests_within_s=None, claims_within_s=None, shard_waits_within_s=None,
        ),
        at=AT,
    )  # fmt: skip


def values_of(state: OperationsView) -> dict[tuple[str, str], float]:
    """Values by name and label."""
    return {
        (sample.name, next(iter(sample.labels.values()), "")): sample.value
        for family in state_families(state)
        for sample in family.samples
    }


def test_a_lost_worker_counts_as_lost_whatever_state_it_was_in() -> None:
    found = values_of(
        a_state(
            seen_worker("one"),
            seen_worker("one", slots=5),
            seen_worker("two", lost=True),
            seen_worker("three", WorkerState.STOPPED),
            seen_worker("four", WorkerState.STOPPED, lost=True),
        )
    )
    assert found["vitac_workers", WorkerState.READY] == 2
    assert found["vitac_workers", WorkerState.STOPPED] == 1
    assert found["vitac_workers", LOST] == 2
    assert found["vitac_worker_slots", ""] == 7
    assert {state for name, state in found if name == "vitac_workers"} == {*WorkerState, LOST}


def test_slots_are_those_of_ready_workers_and_disks_those_of_running_ones() -> None:
    others = [state for state in WorkerState if state not in (WorkerState.READY, WorkerState.STOPPED)]
    found = values_of(
        a_state(
            *(seen_worker(state, state) for state in others),
            seen_worker("ready", disk_bytes=300, disk_free_bytes=0),
            seen_worker("unknown", disk_bytes=None, disk_free_bytes=None),
            seen_worker("stopped", WorkerState.STOPPED),
            seen_worker("lost", lost=True),
        )
    )
    assert found["vitac_worker_slots", ""] == 4
    disks = {host: value for (name, host), value in found.items() if name == "vitac_worker_disk_free_bytes"}
    assert disks == {"ready": 0} | dict.fromkeys(others, 40)
    assert found["vitac_worker_disk_bytes", "ready"] == 300


def test_ages_of_an_empty_queue_are_zero_and_those_of_a_full_one_its_oldest() -> None:
    empty = values_of(a_state())
    assert (empty["vitac_oldest_shard_seconds", ""], empty["vitac_oldest_evaluation_seconds", ""]) == (0, 0)
    assert (empty["vitac_shards", "queued"], empty["vitac_worker_slots", ""]) == (0, 0)
    full = values_of(
        a_state(
            shards_queued=4, shards_running=2, oldest_shard_s=8.5, evaluations_queued=3, evaluations_running=1,
            oldest_evaluation_s=9.5,
            evaluations_unserved=2,
        )
    )  # fmt: skip
    assert (full["vitac_shards", "queued"], full["vitac_shards", "running"]) == (4, 2)
    assert (full["vitac_evaluations", "queued"], full["vitac_evaluations", "running"]) == (3, 1)
    assert (full["vitac_oldest_shard_seconds", ""], full["vitac_oldest_evaluation_seconds", ""]) == (8.5, 9.5)
    sizes = [full[name, ""] for name in ("vitac_uploads", "vitac_uploads_bytes", "vitac_database_bytes")]
    assert sizes == [3, 4000, 50_000]


def test_disks_of_a_server_are_two_gauges_in_bytes() -> None:
    disk = Disk(total_bytes=1000, free_bytes=10)
    assert [(family.name, family.samples[0].value) for family in server_families(disk)] == [
        ("vitac_server_disk_bytes", 1000),
        ("vitac_server_disk_free_bytes", 10),
    ]
