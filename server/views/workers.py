"""Workers as they are shown."""

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
    platform_class: str
    started_at: datetime
    heartbeat_at: datetime
    disk_bytes: int | None
    disk_free_bytes: int | None
