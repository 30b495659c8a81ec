"""Whether the service is up, and its whole state at one moment for organizers and Prometheus. Times in seconds."""

from datetime import datetime

from .base import View
from .workers import WorkersView, WorkerView


class HealthView(View):
    """The process answers."""

    status: str
    version: str


class ReadyView(View):
    """Whether the service can do its work, part by part: `ok` or what is wrong."""

    status: str
    database: str
    migrations: str
    storage: str
    workers: WorkersView | None


class QueueView(View):
    """What waits and what runs; ages are None where nothing waits."""

    shards_queued: int
    shards_running: int
    oldest_shard_s: float | None
    shard_idle_s: float | None
    """Longest time since a running shard has stored an episode."""
    evaluations_queued: int
    evaluations_running: int
    oldest_evaluation_s: float | None
    evaluations_unserved: int
    """Those of another evaluator than the service's that no living worker has."""


class StorageView(View):
    """What submissions and database take up."""

    uploads: int
    """Different stored files; the same file uploaded twice is stored once."""
    uploads_bytes: int
    database_bytes: int


class CountsView(View):
    """What all processes have counted since the database was made.

    `..._within_s`: 95 % took no longer; None before the first, infinite beyond the largest bound that is counted.
    """

    episodes: int
    shards_finished: int
    shard_retries: int
    shards_given_up: int
    leases_lost: int
    requests: int
    requests_failed: int
    """Answered with a status of 500 or above."""
    requests_within_s: float | None
    claims_within_s: float | None
    shard_waits_within_s: float | None


class OperationsView(View):
    """The state of the service, and what was counted."""

    queue: QueueView
    storage: StorageView
    workers: list[WorkerView]
    episodes_in_5_minutes: int
    counts: CountsView
    at: datetime
