"""The route that Prometheus reads."""

import asyncio
import secrets
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response, Security
from fastapi.concurrency import run_in_threadpool
from fastapi.security import HTTPAuthorizationCredentials
from prometheus_client import CONTENT_TYPE_LATEST

from ..errors import ProblemCode, ServiceError, token_missing
from ..operations.exposition import Exposition
from ..principals import Audience
from .access import bearer, get_optional_principal, get_services

_SCRAPES = ThreadPoolExecutor(1, "scrape")
"""Apart from the threads that answer requests, which all wait where the database does not answer."""
router = APIRouter(tags=["health"])


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
