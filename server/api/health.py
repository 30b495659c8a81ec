"""Routes for whoever watches over the service."""

from importlib.metadata import version

from fastapi import APIRouter, Response
from sqlalchemy.exc import DBAPIError

from ..db.schema import is_current
from ..errors import ServiceError
from ..queue.workers import workers_alive
from ..services import Services
from ..views.operations import HealthView, ReadyView
from ..views.workers import WorkersView
from .access import ServicesOf

router = APIRouter(tags=["health"])

OK = "ok"
STORAGE_LIMIT_S = 3.0
"""Whoever asks whether the service is ready waits for seconds only, a request to a bucket may take half a minute."""


@router.get("/health")
async def get_health() -> HealthView:
    """Return the process answers."""
    return HealthView(status=OK, version=version("vitac-arena"))


@router.get("/ready", responses={503: {"model": ReadyView, "description": "A part does not work; it says which."}})
def get_ready(services: ServicesOf, response: Response) -> ReadyView:
    """Return whether database, schema and file store work. Workers are listed but do not make the server unready."""
    database, migrations, workers = _look_at_database(services)
    storage = _look_at_storage(services)
    is_ready = {database, migrations, storage} == {OK}
    response.status_code = 200 if is_ready else 503
    return ReadyView(
        status="ready" if is_ready else "not ready",
        database=database,
        migrations=migrations,
        storage=storage,
        workers=workers,
    )


def _look_at_database(services: Services) -> tuple[str, str, WorkersView | None]:
    try:
        with services.database.transaction() as session:
            alive = workers_alive(session, services.settings)
        migrations = OK if is_current(services.database) else "the schema is not the one of this version"
    except DBAPIError:
        return "does not answer", "not known", None
    return OK, migrations, WorkersView(alive=alive.alive, last_heartbeat_at=alive.last_heartbeat_at)


def _look_at_storage(services: Services) -> str:
    """Return how the file store is; one that hangs is not waited for, and not asked again until it has answered."""
    try:
        services.blobs.check_within(STORAGE_LIMIT_S)
    except TimeoutError:
        return f"does not answer within {STORAGE_LIMIT_S:g} s"
    except ServiceError as error:
        return error.detail
    return OK
