"""What the routes depend on: the open services and the principal behind the bearer token."""

from typing import Annotated, Final

from fastapi import Depends, Path, Request
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from .. import tokens
from ..errors import token_missing
from ..principals import VISITOR, Principal
from ..services import Services

bearer = HTTPBearer(auto_error=False, description="An API token: `vitac_` and 43 characters.")


def get_services(request: Request) -> Services:
    """Return the services that the app opened at its start."""
    services: Services = request.app.state.services
    return services


def get_principal(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
) -> Principal:
    """Return who asks.

    Raises:
        ServiceError: no, unknown, expired or revoked token.
    """
    principal = get_optional_principal(request, credentials)
    if principal is None:
        raise token_missing()
    return principal


def get_optional_principal(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
) -> Principal | None:
    """Return who asks, or None without a token. A token that is given must be good, though.

    Raises:
        ServiceError: unknown, expired or revoked token.
    """
    if credentials is None:
        return None
    with get_services(request).database.reading() as session:
        principal = tokens.authenticate(session, credentials.credentials)
    request.state.account = principal.account
    return principal


def get_reader(principal: Annotated[Principal | None, Depends(get_optional_principal)]) -> Principal:
    """Return who reads; without a token a visitor, who may see what is public."""
    return principal or VISITOR


MAX_NUMBER: Final = 2_147_483_647
"""The largest that a column of numbers holds; the database ends a request with a larger one by an error."""

RowNumber = Annotated[int, Path(ge=1, le=MAX_NUMBER)]
ServicesOf = Annotated[Services, Depends(get_services)]
PrincipalOf = Annotated[Principal, Depends(get_principal)]
OptionalPrincipalOf = Annotated[Principal | None, Depends(get_optional_principal)]
ReaderOf = Annotated[Principal, Depends(get_reader)]
