"""Workers as they are shown."""

from datetime import datetime

from .base import View


class WorkersView(View):
    """Whether anybody works on evaluations."""

    alive: int
    last_heartbeat_at: datetime | None
