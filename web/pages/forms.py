"""Forms: parsed as the route of the API declares that makes the change, then the browser is led back."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints
from uuid import UUID

from fastapi.params import Security
from pydantic import BaseModel, TypeAdapter, ValidationError
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import Audience, Principal

from ..site import get_site, require_viewer, signed_in_form

FormT = TypeVar("FormT", bound=BaseModel)
ID = "id"
"""Field of a form with the id of what it is about."""


async def submit(
    request: Request,
    route: Callable[..., object],
    *,
    back: str,
    ids: Mapping[str, object] | None = None,
    fixed: Mapping[str, object] | None = None,
    read: Callable[[Mapping[str, str]], Mapping[str, object]] = dict,
    takes_back: Callable[..., object] | None = None,
) -> Response:
    """Call a route of the API with a form, then lead back to the page with the form.

    Who may, ids and input are as the route declares them.

    Args:
        request: with the form.
        route: the function of the API.
        back: address of the page.
        ids: what the address of the page says of its parameters; another one is the field `id`.
        fixed: values of its input that the form stands for.
        read: makes values of the fields, where these are not the input itself.
        takes_back: called in place of the route where the form gives no reason.

    Raises:
        ServiceError: the service refuses it.
    """
    viewer, fields = await signed_in_form(request)
    site, given = get_site(request), ids or {}
    if takes_back is not None and "reason" not in fields:
        route = takes_back
    arguments: dict[str, object] = {"services": site.services}
    for name, hint in _declared(route).items():
        if name == "principal":
            _require_audience(hint, viewer.principal, given.get("competition"))
            arguments[name] = viewer.principal
        elif isinstance(hint, type) and issubclass(hint, BaseModel):
            arguments[name] = checked_form(hint, _filled(hint, read(fields)) | dict(fixed or {}))
        elif name != "services":
            arguments[name] = given[name] if name in given else _read_id(hint, fields.get(ID, ""))
    await site.run(lambda: route(**arguments))
    return RedirectResponse(back, status_code=303)


@cache
def _declared(route: Callable[..., object]) -> Mapping[str, Any]:
    hints = get_type_hints(route, include_extras=True)
    return {name: hint for name, hint in hints.items() if name != "return"}


def _require_audience(hint: Any, principal: Principal, competition: object) -> None:
    """Refuse whom the declaration of a route refuses by role."""
    for declared in get_args(hint) if get_origin(hint) is Annotated else ():
        if isinstance(declared, Security):
            for scope in declared.scopes or ():
                Audience(scope).require(principal, None if competition is None else str(competition))


def _filled(model: type[BaseModel], fields: Mapping[str, object]) -> dict[str, object]:
    """Return what a form says of an input: a box that is not ticked is left out by browsers, an empty text is none."""
    found: dict[str, object] = {}
    for name, field in model.model_fields.items():
        value = fields.get(name)
        if field.annotation is bool:
            found[name] = value or False
        elif value is not None and (field.is_required() or not isinstance(value, str) or value.strip()):
            found[name] = value
    return found


def _read_id(hint: Any, text: str) -> object:
    try:
        return TypeAdapter(hint).validate_python(text)
    except ValidationError as error:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected an id or a number as {ID}, got {text!r:.40}. Reload the page."
        ) from error


async def fetch(request: Request, route: Callable[..., Response]) -> Response:
    """Answer with what a route of the API answers to somebody with a session; its ids are those of the address.

    Raises:
        ServiceError: the route is not for them, or refuses it.
    """
    viewer, site = await require_viewer(request), get_site(request)
    ids = {
        name: _read_id(hint, request.path_params[name])
        for name, hint in _declared(route).items()
        if name in request.path_params
    }
    _require_audience(_declared(route)["principal"], viewer.principal, ids.get("competition"))
    answer = await site.run(lambda: route(services=site.services, principal=viewer.principal, **ids))
    answer.headers["Cache-Control"] = "no-store"
    return answer


def list_ticked(fields: Mapping[str, str], prefix: str) -> list[str]:
    """Return the ends of the names of ticked boxes that begin with a prefix."""
    return [name.removeprefix(prefix) for name in fields if name.startswith(prefix)]


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


def checked_form(form: type[FormT], values: Mapping[str, object]) -> FormT:
    """Return the values of a form as the API takes them.

    Raises:
        ServiceError: invalid_request, with what is wrong.
    """
    try:
        return form.model_validate(values)
    except ValidationError as error:
        problems = " ".join(f"{problem['loc'][0]}: {problem['msg']}." for problem in error.errors())
        raise ServiceError(ProblemCode.INVALID_REQUEST, problems) from error


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
