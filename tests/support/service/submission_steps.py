"""What tests of submissions do in one transaction each: submit, look, let the policy or a worker appear."""

from typing import Any

import pytest
from service_factories import (
    claim,
    finish,
    make_failed_record,
    make_settings,
    make_upload,
    shard_ids,
    store,
)
from vitac.evaluator.shards.order import ShardEnd
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission, Worker
from vitac.server.database.states import WorkerState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import workers
from vitac.server.submissions import creation, listing
from vitac.server.views.submissions import SubmissionView

SETTINGS = make_settings()


def view_of(database: Database, principal: Principal, submission: Submission) -> SubmissionView:
    with database.transaction() as session:
        return listing.get(session, SETTINGS, principal, submission.id)


def create(
    database: Database, principal: Principal, content: str = "content", **options: Any
) -> tuple[Submission, bool]:
    with database.transaction() as session:
        return creation.create(session, principal, make_upload(content), **options)


def ids_of(database: Database, submission: Submission) -> list[int]:
    with database.transaction() as session:
        return shard_ids(session, submission)


def make_worker(database: Database, **changes: Any) -> None:
    values = {
        "host": "h",
        "pid": 1,
        "slots": 2,
        "state": WorkerState.READY,
        "evaluator_version": evaluator_version(),
        "platform_class": "p",
        "isolation": "i",
        "message": "",
    }
    with database.transaction() as session:
        workers.register(session, Worker(**(values | changes)))


def break_policy(database: Database, submission: Submission) -> None:
    lease = claim(database, ids_of(database, submission)[0])
    store(database, lease, [make_failed_record(n, output=f"out {n}") for n in (1, 2, 3)])
    assert view_of(database, CONSOLE, submission).evaluation.log_tail == "out 3"
    finish(database, lease, ShardEnd.BROKEN)


def refused(code: ProblemCode) -> "pytest.RaisesExc[ServiceError]":
    return pytest.raises(ServiceError, check=lambda error: error.code is code)
