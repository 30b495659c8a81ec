"""Shows errors as pages to browsers; programs still get the API's problem JSON."""

import inspect
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Any, cast

from fastapi import FastAPI
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import UnknownTask, UnknownTrack
from vitac.server.api.problems import refusal_of_failure
from vitac.server.errors import ProblemCode, ServiceError

from ..headers import HEADERS
from ..session import COOKIE
from ..site import SignInNeeded, Viewer, get_viewer, page, sign_in_first

Handler = Callable[[Request, Exception], Response | Awaitable[Response]]

TITLES = {
    400: "Invalid request",
    403: "Not allowed",
    404: "Page not found",
    405: "Method not allowed",
    408: "Too slow",
    409: "No longer possible",
    410: "Track no longer here",
    413: "Too large",
    415: "Unsupported form",
    422: "Not accepted",
    429: "Too many requests",
    500: "Internal error",
    503: "Service not ready",
    507: "Disk full",
}
CRASHED = (
    "The error is on our side and has been recorded. Try again; if it persists, tell the organizers when it happened."
)
MISSING = "This page does not exist or belongs to another team. Check the address, or sign in with the right token."


def install(app: FastAPI) -> None:
    """Add HTML answers to the error handlers that the application already has, and the way to the sign-in page."""
    app.add_exception_handler(SignInNeeded, sign_in_first)
    for kind in (ServiceError, HTTPException, SQLAlchemyError, OSError, UnknownTrack, UnknownTask, Exception):
        app.add_exception_handler(kind, _handler_with_page(app.exception_handlers[kind]))


def wants_page(request: Request) -> bool:
    """Return whether a browser requests a page, rather than a program the API."""
    return not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", "")


def _handler_with_page(api_handler: object) -> Handler:
    async def handler(request: Request, error: Exception) -> Response:
        if wants_page(request):
            return await _page(request, error)
        answer = cast("Handler", api_handler)(request, error)
        return await answer if inspect.isawaitable(answer) else answer

    return handler


async def _page(request: Request, error: Exception) -> Response:
    status, detail, headers = _explain(request, error)
    title = TITLES.get(status, HTTPStatus(status).phrase)
    # Neither a database that has just failed is asked, nor for somebody who asks too often.
    failed = isinstance(error, SQLAlchemyError) or getattr(error, "code", None) is ProblemCode.DATABASE_UNAVAILABLE
    asks = status != HTTPStatus.TOO_MANY_REQUESTS and not failed
    viewer, viewer_known = await _viewer(request) if asks or COOKIE not in request.cookies else (None, False)
    shown: dict[str, Any] = {"viewer_known": viewer_known, "code": status, "title": title, "detail": detail}
    shown["request_id"] = getattr(request.state, "request_id", None)
    answer = page(request, "error.html", viewer=viewer, status=status, **shown)
    answer.headers.update(headers)
    answer.headers.update(HEADERS)
    return answer


async def _viewer(request: Request) -> tuple[Viewer | None, bool]:
    """Return who is signed in, and whether that is known."""
    try:
        return await get_viewer(request), True
    except Exception:  # noqa: BLE001 - whatever it is, the page shows the first error
        return None, False


def _explain(request: Request, error: Exception) -> tuple[int, str, dict[str, str]]:
    if isinstance(error, ServiceError):
        return error.status.value, error.detail, {}
    if isinstance(error, HTTPException):
        ours = error.detail != HTTPStatus(error.status_code).phrase
        return error.status_code, error.detail if ours else MISSING, dict(error.headers or {})
    if (refusal := refusal_of_failure(request, error)) is not None:
        is_away = refusal.code is ProblemCode.DATABASE_UNAVAILABLE
        return refusal.status.value, refusal.detail, {"Retry-After": "2"} if is_away else {}
    return 500, CRASHED, {}
