"""The route that Prometheus reads."""

import secrets
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from fastapi.security import HTTPAuthorizationCredentials
from prometheus_client import CONTENT_TYPE_LATEST

from ..errors import ProblemCode, ServiceError
from ..operations.exposition import Exposition
from .access import bearer, get_principal, get_services

router = APIRouter(tags=["health"])


def require_metrics_reader(
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
    if not get_principal(request, credentials).is_organizer:
        raise ServiceError(ProblemCode.FORBIDDEN, "Metrics are for organizers and the holder of VITAC_METRICS_TOKEN.")


@router.get(
    "/metrics",
    dependencies=[Depends(require_metrics_reader)],
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}, "description": "Metrics in Prometheus' text format."}},
)
def get_metrics(request: Request) -> Response:
    """Return the state of the service and what all its processes have counted, for Prometheus."""
    exposition: Exposition = request.app.state.exposition
    return Response(exposition.text(), media_type=CONTENT_TYPE_LATEST)
