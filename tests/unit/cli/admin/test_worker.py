import json
import re
from datetime import timedelta
from uuid import UUID, uuid4

import pytest
from cli_service import CliService
from sqlalchemy import func, text
from vitac.cli.service import database
from vitac.server.database.models import Worker
from vitac.server.database.states import WorkerOrder, WorkerState


def add_worker(service: CliService, state: WorkerState, seen_ago: timedelta) -> UUID:
    with service.database.transaction() as session:
        worker = Worker(
            id=uuid4(), host="machine", pid=1, slots=2, state=state, evaluator_version="1+a", isolation="user: root",
            platform_class="x86_64-linux", heartbeat_at=func.clock_timestamp() - seen_ago,
        )  # fmt: skip
        session.add(worker)
        return worker.id


def order_of(service: CliService, worker: UUID) -> WorkerOrder:
    with service.database.transaction() as session:
        return session.get_one(Worker, worker).worker_order


def test_a_worker_that_was_killed_an_hour_ago_is_not_ready(service: CliService) -> None:
    killed = add_worker(service, WorkerState.READY, timedelta(hours=1))
    ended = add_worker(service, WorkerState.STOPPED, timedelta(hours=1))
    alive = add_worker(service, WorkerState.READY, timedelta(0))
    listed = json.loads(service.run("admin", "worker", "list", "--json").stdout)
    lost = {UUID(one["id"]): one["is_lost"] for one in listed}
    assert (lost[killed], lost[ended], lost[alive]) == (True, False, False)
    shown = service.run("admin", "worker", "list").stdout
    assert re.search(f"{killed} .* lost .*1\\+a", shown), shown


def test_an_organizer_cordons_and_drains_workers(service: CliService) -> None:
    worker = add_worker(service, WorkerState.READY, timedelta(0))
    for verb, order in (("cordon", WorkerOrder.CORDON), ("uncordon", WorkerOrder.WORK), ("drain", WorkerOrder.DRAIN)):
        before = order_of(service, worker)
        assert service.run("admin", "worker", verb, str(worker), "--dry-run").exit_code == 0
        assert order_of(service, worker) is before
        assert service.run("admin", "worker", verb, str(worker)).exit_code == 0
        assert order_of(service, worker) is order
    ended = add_worker(service, WorkerState.STOPPED, timedelta(0))
    assert service.run("admin", "worker", "drain", str(ended)).exit_code == 1


def test_a_lock_that_stands_in_the_way_ends_a_command_with_a_sentence(
    service: CliService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "STATEMENT_TIMEOUT_S", 0.4)
    monkeypatch.setattr(database, "SAID_AFTER_S", 0.1)
    with service.database.transaction() as session:
        session.execute(text("LOCK TABLE workers"))
        result = service.run("admin", "worker", "list")
    assert "The database took too long" in str(result.exception)
    assert "the database is busy, locked, or does not answer" in result.stderr
