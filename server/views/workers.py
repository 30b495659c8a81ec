"""Workers as they are shown."""

from datetime import datetime
from uuid import UUID

from ..db.states import WorkerState
from .base import View


class WorkersView(View):
    """Whether anybody works on evaluations."""

    alive: int
    last_heartbeat_at: datetime | None


class WorkerView(View):
    """A worker process and what it says about itself."""

    id: UUID
    host: str
    pid: int
    slots: int
    state: WorkerState
    message: str
    isolation: str
    evaluator_version: str
    platform_class: str
    started_at: datetime
    heartbeat_at: datetime
    disk_bytes: int | None
    disk_free_bytes: int | None
