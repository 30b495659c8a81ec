"""Every error answer of the API as RFC 9457 problem JSON with a stable `code`."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeout
from starlette.exceptions import HTTPException
from vitac.evaluator.tracks import UnknownTask, UnknownTrack

from ..database.engine import has_no_free_connection, is_cancelled, is_connection_loss
from ..errors import TRACK_REMOVED, ProblemCode, ServiceError, storage_full
from ..settings import Settings
from ..storage.scratch import has_space, is_disk_full

logger = structlog.get_logger(__name__)

MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 2

_CODE_OF_STATUS: Mapping[int, ProblemCode] = {
    HTTPStatus.NOT_FOUND: ProblemCode.NOT_FOUND,
    HTTPStatus.METHOD_NOT_ALLOWED: ProblemCode.METHOD_NOT_ALLOWED,
}


class ProblemView(BaseModel):
    """RFC 9457 problem; `code` is stable, further members depend on it."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: str
    instance: str
    request_id: str | None = None
    errors: list[dict[str, Any]] | None = None


RESPONSES: dict[int | str, dict[str, Any]] = {
    "default": {"model": ProblemView, "description": "A problem; `code` says which.", "content": {MEDIA_TYPE: {}}}
}
"""For the routers: what OpenAPI says about errors."""


def install(app: FastAPI) -> None:
    """Make every error of the app a problem."""
    app.add_exception_handler(ServiceError, _answer_service_error)
    app.add_exception_handler(RequestValidationError, _answer_invalid_request)
    app.add_exception_handler(HTTPException, _answer_http_error)
    app.add_exception_handler(SQLAlchemyError, _answer_failure)
    app.add_exception_handler(OSError, _answer_failure)
    app.add_exception_handler(UnknownTrack, _answer_failure)
    app.add_exception_handler(UnknownTask, _answer_failure)
    app.add_exception_handler(Exception, _answer_bug)


def problem(
    request: Request, error: ServiceError, headers: Mapping[str, str] | None = None, *, status: int | None = None
) -> JSONResponse:
    """Return the answer for a refusal, with its usual status unless another one is given."""
    status = status or int(error.status)
    content = {
        "type": f"urn:vitac:problem:{error.code}",
        "title": _phrase(status) or error.status.phrase,
        "status": status,
        "detail": error.detail,
        "code": str(error.code),
        "instance": request.url.path,
        **error.extras,
    }
    if request_id := getattr(request.state, "request_id", None):
        content["request_id"] = request_id
    return JSONResponse(content, status, {**_headers(error), **(headers or {})}, media_type=MEDIA_TYPE)


def _phrase(status: int) -> str | None:
    """Return the name of a status; None where a protocol of its own has added it."""
    return next((known.phrase for known in HTTPStatus if known == status), None)


def _headers(error: ServiceError) -> dict[str, str]:
    if error.status is HTTPStatus.UNAUTHORIZED:
        return {"WWW-Authenticate": "Bearer"}
    if error.status in (HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.TOO_MANY_REQUESTS):
        return {"Retry-After": str(error.extras.get("retry_after_s", RETRY_AFTER_S))}
    return {}


def _answer_service_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, ServiceError)  # noqa: S101 - the registration says so
    # An upload that is refused early still has its body on the way: the connection cannot be used again.
    return problem(request, error, {"Connection": "close"} if _leaves_body_unread(request) else None)


def _leaves_body_unread(request: Request) -> bool:
    return request.method == "PATCH" or (request.method == "POST" and request.url.path.endswith("/submissions"))


def _answer_invalid_request(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)  # noqa: S101 - the registration says so
    errors = [{"place": _place(item["loc"]), "message": item["msg"]} for item in error.errors()]
    detail = " ".join(f"{item['place']}: {item['message']}." for item in errors)
    return problem(request, ServiceError(ProblemCode.INVALID_REQUEST, detail, errors=errors))


def _place(location: Sequence[object]) -> str:
    """Return where in a request something is wrong; a key of a JSON body need not be valid text."""
    return ".".join(map(str, location)).encode("utf-8", "backslashreplace").decode()


def _answer_http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)  # noqa: S101 - the registration says so
    code = _CODE_OF_STATUS.get(error.status_code)
    if code is ProblemCode.NOT_FOUND:
        detail = f"There is nothing at {request.url.path}. The API is below /api/v1; /openapi.json lists it."
        return problem(request, ServiceError(code, detail))
    if code is ProblemCode.METHOD_NOT_ALLOWED:
        allowed = (error.headers or {}).get("Allow", "")
        detail = f"{request.method} is not possible at {request.url.path}; allowed: {allowed}."
        return problem(request, ServiceError(code, detail), error.headers)
    if error.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
        too_large = ServiceError(ProblemCode.BODY_TOO_LARGE, str(error.detail))
        return problem(request, too_large, {"Connection": "close"})
    fallback = ServiceError(ProblemCode.INVALID_REQUEST, str(error.detail))
    return problem(request, fallback, error.headers, status=error.status_code)


def _answer_failure(request: Request, error: Exception) -> JSONResponse:
    refusal = refusal_of_failure(request, error)
    return _answer_service_error(request, refusal) if refusal is not None else _answer_bug(request, error)


def refusal_of_failure(request: Request, error: Exception) -> ServiceError | None:
    """Return why disk, database or track file cannot be used now, or None if the error says something else."""
    if isinstance(error, UnknownTrack | UnknownTask):
        return ServiceError(ProblemCode.TRACK_REMOVED, f"{TRACK_REMOVED} {error}")
    if is_disk_full(error):
        return storage_full()
    if isinstance(error, DBAPIError) and is_cancelled(error):
        return ServiceError(ProblemCode.DATABASE_UNAVAILABLE, "The database took too long; try again in a moment.")
    is_lost = isinstance(error, DBAPIError) and is_connection_loss(error)
    if not is_lost and not isinstance(error, PoolTimeout):
        return None
    # The embedded database ends when it cannot write its own log, and comes back when there is room.
    settings: Settings = request.app.state.settings
    if settings.database_url is None and not has_space(settings.state_dir):
        return storage_full()
    reason = "is starting or unavailable"
    if isinstance(error, DBAPIError) and has_no_free_connection(error.orig):
        reason = "has no free connection"
    detail = f"The database {reason}; try again in a moment."
    return ServiceError(ProblemCode.DATABASE_UNAVAILABLE, detail)


def _answer_bug(request: Request, error: Exception) -> JSONResponse:
    logger.error("request_failed", path=request.url.path, method=request.method, exc_info=error)
    detail = "The server failed; the error was logged. Try again later or tell the organizers when it happened."
    return problem(request, ServiceError(ProblemCode.INTERNAL_ERROR, detail))
