"""Turns refusals and crashes into pages for browsers; programs keep getting the service's problem JSON."""

from __future__ import annotations

import inspect
from http import HTTPStatus
from typing import TYPE_CHECKING, cast

from sqlalchemy.exc import DBAPIError
from starlette.exceptions import HTTPException
from vitac.server.db.engine import is_connection_loss
from vitac.server.errors import ServiceError

from ..headers import HEADERS
from ..site import page

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from fastapi import FastAPI
    from starlette.requests import Request
    from starlette.responses import Response

    Handler = Callable[[Request, Exception], Response | Awaitable[Response]]

TITLES = {
    400: "That request cannot be read",
    403: "Not allowed",
    404: "Nothing is here",
    405: "Not possible this way",
    409: "Not possible any more",
    413: "Too large",
    415: "Not a form of this site",
    429: "Too many requests",
    500: "Something broke here",
    503: "Not ready",
}
CRASHED = (
    "The error is on our side and is in the server's log. Try again; if it stays, tell the organizers when it happened."
)
DATABASE_AWAY = "The database is starting again. Nothing is lost; load this page again in a few seconds."
MISSING = "There is no such page, or it belongs to another team. Check the address, or sign in with the right token."


def install(app: FastAPI) -> None:
    """Put an HTML answer in front of the handlers that the application has already."""
    for kind in (ServiceError, HTTPException, DBAPIError, Exception):
        app.add_exception_handler(kind, _for_browsers(app.exception_handlers.get(kind)))


def wants_page(request: Request) -> bool:
    """Tell whether a browser asks for a page (and not a program for the API)."""
    return not request.url.path.startswith("/api/") and "text/html" in request.headers.get("accept", "")


def _for_browsers(otherwise: object) -> Handler:
    async def handler(request: Request, error: Exception) -> Response:
        if wants_page(request) or otherwise is None:
            return _page(request, error)
        answer = cast("Handler", otherwise)(request, error)
        return await answer if inspect.isawaitable(answer) else answer

    return handler


def _page(request: Request, error: Exception) -> Response:
    status, detail, headers = _explain(error)
    title = TITLES.get(status, HTTPStatus(status).phrase)
    answer = page(request, "error.html", viewer=None, status=status, code=status, title=title, detail=detail)
    answer.headers.update(headers)
    answer.headers.update(HEADERS)
    return answer


def _explain(error: Exception) -> tuple[int, str, dict[str, str]]:
    if isinstance(error, ServiceError):
        return error.status.value, error.detail, {}
    if isinstance(error, HTTPException):
        ours = error.detail != HTTPStatus(error.status_code).phrase
        return error.status_code, error.detail if ours else MISSING, dict(error.headers or {})
    if isinstance(error, DBAPIError) and is_connection_loss(error):
        return 503, DATABASE_AWAY, {"Retry-After": "2"}
    return 500, CRASHED, {}
