"""One action of a form: who may send it, the change in one transaction, and where the browser goes then."""

from collections.abc import Callable, Mapping
from typing import TypeVar
from uuid import UUID

from pydantic import BaseModel, ValidationError
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import Principal

from ..site import get_site, signed_in_form

FormT = TypeVar("FormT", bound=BaseModel)


async def act(
    request: Request, change: Callable[[Session, Principal, Mapping[str, str]], object], *, back: str
) -> Response:
    """Make the change that a form asks for, then lead back to the page with the form.

    Raises:
        ServiceError: the service refuses it.
    """
    viewer, fields = await signed_in_form(request)
    await get_site(request).ask(lambda session: change(session, viewer.principal, fields))
    return RedirectResponse(back, status_code=303)


def checked_form(form: type[FormT], values: Mapping[str, str | None]) -> FormT:
    """Return the values of a form as the API takes them.

    Raises:
        ServiceError: invalid_request, with what is wrong.
    """
    try:
        return form.model_validate(values)
    except ValidationError as error:
        problems = " ".join(f"{problem['loc'][0]}: {problem['msg']}." for problem in error.errors())
        raise ServiceError(ProblemCode.INVALID_REQUEST, problems) from error


def read_number(fields: Mapping[str, str], name: str) -> int:
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


def read_id(fields: Mapping[str, str], name: str) -> UUID:
    """Return an id out of a form.

    Raises:
        ServiceError: there is none.
    """
    try:
        return UUID(fields.get(name, ""))
    except ValueError:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected an id as {name}, got {fields.get(name, '')!r:.40}. Reload the page."
        ) from None
