"""Whether the service is up, and its whole state at one moment for organizers and Prometheus. Times in seconds."""

from datetime import datetime
from uuid import UUID

from pydantic import Field
from vitac.envs.tasks.definition import Family

from ..database.states import WorkerOrder, WorkerState
from .base import View


class WorkersView(View):
    """Whether anybody works on evaluations."""

    alive: int = Field(description="Those that can run the tasks of the submission.")
    missing_family: Family | None = Field(
        default=None, description="A family of its tasks that none of the running workers has what it needs for."
    )
    missing_evaluator: str | None = Field(
        default=None, description="The evaluator that the evaluation began with, where no running worker has it."
    )
    lacks_gpu: bool = Field(default=False, description="Whether the submission needs a GPU, which none of them has.")
    last_heartbeat_at: datetime | None


class WorkerView(View):
    """A worker process and what it says about itself."""

    id: UUID
    host: str
    pid: int
    slots: int
    state: WorkerState = Field(description="What it last said about itself.")
    is_lost: bool = Field(
        description="No heartbeat for longer than `VITAC_WORKER_LOST_AFTER_S`, although it did not report its end."
    )
    worker_order: WorkerOrder = Field(description="What an organizer has asked it to do.")
    shards: list[int] = Field(description="That it runs.")
    message: str
    isolation: str
    evaluator_version: str
    families: list[Family] = Field(description="Of whose tasks it can run shards.")
    has_gpu: bool = Field(description="Whether it plays images that need a GPU.")
    platform_class: str
    started_at: datetime
    heartbeat_at: datetime
    disk_bytes: int | None
    disk_free_bytes: int | None


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
