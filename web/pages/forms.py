"""Forms: parsed as the route of the API declares that makes the change, then the browser is led back."""

from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from fastapi.params import Security
from pydantic import BaseModel, TypeAdapter, ValidationError
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.errors import ProblemCode, ServiceError, not_found
from vitac.server.principals import VISITOR, Audience, Principal

from ..site import Page, get_site, require_viewer, signed_in_form

ResultT = TypeVar("ResultT")
FormT = TypeVar("FormT", bound=BaseModel)
Fields = Mapping[str, str]
ID = "id"
"""Field of a form with the id of what it is about."""


def form(
    route: Callable[..., object],
    *,
    back: str | None = None,
    values: Callable[[Fields], Mapping[str, object]] = lambda _: {},
    ids: Callable[[Session, Principal], Mapping[str, object]] | None = None,
    takes_back: Callable[..., object] | None = None,
) -> Page:
    """Return the page that calls a route of the API with a form, and leads back to the page with the form.

    Args:
        route: the function of the API. Who may, ids and input are as it declares them.
        back: where it leads, with ids of the address in braces; None: the address without its last part.
        values: of the input, where the fields of that name do not say them.
        ids: of the route that neither the address says nor the field `id`.
        takes_back: called in place of the route where the form gives no reason.
    """

    async def change(request: Request) -> Response:
        viewer, fields = await signed_in_form(request)
        given = {} if ids is None else await get_site(request).read(lambda session: ids(session, viewer.principal))
        called = takes_back if takes_back is not None and "reason" not in fields else route
        await call(request, called, viewer.principal, fields, values=values(fields), ids=given)
        here = request.url.path.rpartition("/")[0]
        return RedirectResponse(here if back is None else back.format(**request.path_params), status_code=303)

    return change


async def call(
    request: Request,
    route: Callable[..., ResultT],
    by: Principal | None,
    fields: Fields,
    *,
    values: Mapping[str, object] = MappingProxyType({}),
    ids: Mapping[str, object] = MappingProxyType({}),
) -> ResultT:
    """Call a route of the API with the fields of a form, and return what it answers.

    Args:
        request: with the form.
        route: the function of the API.
        by: who sent it; None: somebody who is not signed in.
        fields: of the form.
        values: of the input, where the fields of that name do not say them.
        ids: of the route that the address does not say; a further one is the field `id`.

    Raises:
        ServiceError: the service refuses it.
    """
    site, ids = get_site(request), request.path_params | dict(ids)
    arguments: dict[str, object] = {"services": site.services}
    for name, hint in _declared(route).items():
        if name == "principal":
            _require_audience(hint, by or VISITOR, ids.get("competition"))
            arguments[name] = by
        elif hint is Request:
            arguments[name] = request
        elif isinstance(hint, type) and issubclass(hint, BaseModel):
            arguments[name] = checked_form(hint, {**_filled(hint, fields), **values})
        elif name != "services":
            arguments[name] = _read_id(hint, name, ids, fields)
    return await site.run(lambda: route(**arguments))


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


def _filled(model: type[BaseModel], fields: Fields) -> dict[str, object]:
    """Return what a form says of an input: a box that is not ticked is left out by browsers, an empty text is none."""
    filled: dict[str, object] = {}
    for name, field in model.model_fields.items():
        value = fields.get(name)
        if field.annotation is bool:
            filled[name] = value or False
        elif value is not None and (field.is_required() or value.strip()):
            filled[name] = value
    return filled


def _read_id(hint: Any, name: str, ids: Mapping[str, object], fields: Fields) -> object:
    """Return what the address names, or the form."""
    text = ids.get(name, fields.get(ID, ""))
    try:
        return TypeAdapter(hint).validate_python(text)
    except ValidationError as error:
        if name in ids:
            raise not_found(name.removesuffix("_id"), str(text)) from error
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected an id or a number as {ID}, got {text!r:.40}. Reload the page."
        ) from error


async def fetch(request: Request, route: Callable[..., Response]) -> Response:
    """Answer with what a route of the API answers to somebody with a session; its ids are those of the address.

    Raises:
        ServiceError: the route is not for them, or refuses it.
    """
    viewer = await require_viewer(request)
    answer = await call(request, route, viewer.principal, {})
    answer.headers["Cache-Control"] = "no-store"
    return answer


def list_ticked(fields: Fields, prefix: str) -> list[str]:
    """Return the ends of the names of ticked boxes that begin with a prefix."""
    return [name.removeprefix(prefix) for name in fields if name.startswith(prefix)]


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
