from datetime import UTC, datetime, timedelta
from typing import Any

from page_fixtures import a_sandbox
from service_factories import make_settings
from submission_steps import make_worker
from vitac.evaluator.agent.description import SandboxDescription
from vitac.server.database.engine import Database
from vitac.server.database.states import WorkerState
from vitac.server.queue.workers import sandboxes

LONG_AGO = datetime.now(UTC) - timedelta(hours=1)
OURS, OTHER = a_sandbox(), a_sandbox(machine="aarch64")


def told(database: Database) -> list[SandboxDescription]:
    with database.transaction() as session:
        return list(sandboxes(session, make_settings()))


def worker(database: Database, sandbox: SandboxDescription | None, **changes: Any) -> None:
    make_worker(database, sandbox=sandbox.model_dump(mode="json") if sandbox else None, **changes)


def test_each_kind_of_sandbox_is_told_once(database: Database) -> None:
    assert told(database) == []
    for sandbox in (OURS, OURS, OTHER):
        worker(database, sandbox)
    assert sorted(told(database), key=lambda one: one.machine) == [OTHER, OURS]


def test_only_workers_that_take_shards_count(database: Database) -> None:
    worker(database, OURS)
    worker(database, OTHER, heartbeat_at=LONG_AGO)
    worker(database, None, state=WorkerState.REFUSING)
    assert told(database) == [OURS]


def test_without_any_the_last_one_counts(database: Database) -> None:
    worker(database, OTHER, heartbeat_at=LONG_AGO - timedelta(hours=1))
    worker(database, OURS, heartbeat_at=LONG_AGO, state=WorkerState.STOPPED)
    assert told(database) == [OURS]
