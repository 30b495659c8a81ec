"""Whether the service is up."""

from .base import View
from .workers import WorkersView


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
