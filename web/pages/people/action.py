"""One action of a form: who may send it, the change in one transaction, and where the browser goes then."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from starlette.responses import RedirectResponse, Response
from vitac.server.errors import ProblemCode, ServiceError

from ...session.forms import read_form
from ...site import require_form_token, require_viewer, site_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from uuid import UUID

    from sqlalchemy.orm import Session
    from starlette.requests import Request
    from vitac.server.accounts.principals import Principal

    from ...site import Viewer

ResultT = TypeVar("ResultT")


async def signed_in_form(request: Request) -> tuple[Viewer, Mapping[str, str]] | Response:
    """Return who sent a form and its fields, or the way to the sign-in page.

    Raises:
        HTTPException: it was not sent by a page of this session.
    """
    viewer = await require_viewer(request)
    if isinstance(viewer, Response):
        return viewer
    fields = await read_form(request)
    require_form_token(request, fields, viewer)
    return viewer, fields


async def act(
    request: Request, change: Callable[[Session, Principal, Mapping[str, str]], object], *, back: str
) -> Response:
    """Make the change that a form asks for, then lead back to the page with the form.

    Raises:
        ServiceError: the service refuses it.
    """
    sent = await signed_in_form(request)
    if isinstance(sent, Response):
        return sent
    viewer, fields = sent
    await site_of(request).data.ask(lambda session: change(session, viewer.visitor.principal, fields))
    return RedirectResponse(back, status_code=303)


def number_in(fields: Mapping[str, str], name: str) -> int:
    """Return the number of a row out of a form.

    Raises:
        ServiceError: there is none.
    """
    given = fields.get(name, "")
    if not (given.isascii() and given.isdigit() and len(given) < 10 and int(given)):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected a number as {name}, got {given!r:.40}. Reload the page."
        )
    return int(given)


def id_in(fields: Mapping[str, str], name: str) -> UUID:
    """Return an id out of a form.

    Raises:
        ServiceError: there is none.
    """
    from uuid import UUID

    try:
        return UUID(fields.get(name, ""))
    except ValueError:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected an id as {name}, got {fields.get(name, '')!r:.40}. Reload the page."
        ) from None
