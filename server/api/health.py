"""Routes for whoever watches over the service, Prometheus among them."""

import asyncio
import secrets
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from typing import Annotated, TypeVar

from fastapi import APIRouter, Depends, Request, Response, Security
from fastapi.concurrency import run_in_threadpool
from fastapi.security import HTTPAuthorizationCredentials
from prometheus_client import CONTENT_TYPE_LATEST
from sqlalchemy.exc import DBAPIError

from ..database.schema import explain_other_schema
from ..errors import ProblemCode, ServiceError, token_missing
from ..operations.exposition import Exposition
from ..principals import Audience
from ..queue.workers import workers_alive
from ..services import Services
from ..views.operations import HealthView, ReadyView, WorkersView
from .access import ServicesOf, bearer, get_optional_principal, get_services

router = APIRouter(tags=["health"])

OK = "ok"
NO_ANSWER = "does not answer"
ResultT = TypeVar("ResultT")
DatabaseState = tuple[str, str, WorkersView | None]
NOT_KNOWN: DatabaseState = (NO_ANSWER, "not known", None)
LIMIT_S = 3.0
"""Whoever asks whether the service is ready waits for seconds only; a bucket may take half a minute to answer, and a
database that stands still does not answer at all."""
_LOOKS = ThreadPoolExecutor(2, "ready")
"""Apart from the threads that answer requests, which all wait where the database does not answer."""


@router.get("/health")
async def get_health() -> HealthView:
    """Return that the process answers."""
    return HealthView(status=OK, version=version("vitac-arena"))


@router.get(
    "/ready", responses={503: {"model": ReadyView, "description": "A part does not work; the answer says which."}}
)
async def get_ready(services: ServicesOf, response: Response) -> ReadyView:
    """Return whether database, schema and file store work. Workers are listed but do not make the server unready."""
    (database, migrations, workers), storage = await asyncio.gather(
        _within(LIMIT_S, _look_at_database, services, NOT_KNOWN),
        _within(2 * LIMIT_S, _look_at_storage, services, NO_ANSWER),
    )
    is_ready = {database, migrations, storage} == {OK}
    response.status_code = 200 if is_ready else 503
    return ReadyView(
        status="ready" if is_ready else "not ready",
        database=database,
        migrations=migrations,
        storage=storage,
        workers=workers,
    )


async def _within(
    limit_s: float, look: Callable[[Services], ResultT], services: Services, otherwise: ResultT
) -> ResultT:
    """Return what is seen; `otherwise` where it takes too long, or earlier looks still do."""
    try:
        return await asyncio.wait_for(asyncio.wrap_future(_LOOKS.submit(look, services)), limit_s)
    except TimeoutError:
        return otherwise


def _look_at_database(services: Services) -> DatabaseState:
    try:
        with services.database.transaction() as session:
            alive = workers_alive(session, services.settings)
        with services.database.engine.connect() as connection:
            migrations = explain_other_schema(connection) or OK
    except DBAPIError:
        return NOT_KNOWN
    return OK, migrations, WorkersView(alive=alive.alive, last_heartbeat_at=alive.last_heartbeat_at)


def _look_at_storage(services: Services) -> str:
    """Return how the file store is; one that hangs is not waited for, and not asked again until it has answered."""
    try:
        services.blobs.check_within(LIMIT_S)
    except TimeoutError:
        return f"does not answer within {LIMIT_S:g} s"
    except ServiceError as error:
        return error.detail
    return OK


_SCRAPES = ThreadPoolExecutor(1, "scrape")
"""Apart from the threads that answer requests, which all wait where the database does not answer."""


async def require_metrics_reader(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
) -> None:
    """Let the holder of VITAC_METRICS_TOKEN pass, without the database, and organizers.

    Raises:
        ServiceError: anybody else; names of hosts and how busy the service is are not for the world.
    """
    expected = get_services(request).settings.metrics_token
    if expected is not None and credentials is not None:
        given = credentials.credentials.encode()
        if secrets.compare_digest(given, expected.get_secret_value().encode()):
            return
    principal = await run_in_threadpool(get_optional_principal, request, credentials)
    if principal is None:
        raise token_missing()
    if not principal.organizes_service:
        raise ServiceError(ProblemCode.FORBIDDEN, "Metrics are for organizers and the holder of VITAC_METRICS_TOKEN.")


@router.get(
    "/metrics",
    dependencies=[Security(require_metrics_reader, scopes=[Audience.ORGANIZERS])],
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}, "description": "Metrics in Prometheus' text format."}},
)
async def get_metrics(request: Request) -> Response:
    """Return the state of the service and what all its processes have counted, for Prometheus."""
    exposition: Exposition = request.app.state.exposition
    text = await asyncio.wrap_future(_SCRAPES.submit(exposition.text))
    return Response(text, media_type=CONTENT_TYPE_LATEST)
