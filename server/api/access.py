"""What the routes depend on: the open services, and the principal behind the bearer token, who may call the route."""

from typing import Annotated, Final

from fastapi import Depends, Header, Path, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer, SecurityScopes
from starlette.requests import HTTPConnection

from ..accounts import teams, tokens
from ..errors import token_missing
from ..limiter import client_key
from ..principals import VISITOR, Audience, Principal
from ..services import Services

bearer = HTTPBearer(auto_error=False, description="An API token: `vitac_` and 43 characters.")


def get_services(request: Request) -> Services:
    """Return the services that the app opened at its start."""
    services: Services = request.app.state.services
    return services


def get_changing_services(
    services: Annotated[Services, Depends(get_services)],
    dry_run: Annotated[
        bool, Header(description="Answer what the change would answer, and change nothing: ids and secrets are none.")
    ] = False,
) -> Services:
    """Return services to change something with; nothing is kept in a dry run."""
    return services.make_trial() if dry_run else services


def get_optional_principal(
    request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Depends(bearer)]
) -> Principal | None:
    """Return who asks, or None without a token. A token that is given must be good, though.

    In the process of an organizer's command on the server machine there is no token, and its organizer asks.

    Raises:
        ServiceError: unknown, expired or revoked token.
    """
    if credentials is None:
        caller: Principal | None = request.app.state.caller
        return caller
    with get_services(request).database.reading() as session:
        principal = tokens.authenticate(session, credentials.credentials)
    request.state.account = principal.account
    return principal


def get_principal(
    request: Request,
    scopes: SecurityScopes,
    principal: Annotated[Principal | None, Depends(get_optional_principal)],
) -> Principal:
    """Return who asks, for a route that is not for everybody.

    Raises:
        ServiceError: no, unknown, expired or revoked token, or it is not for them.
    """
    if principal is None:
        raise token_missing()
    for name in scopes.scopes:
        Audience(name).require(principal, request.path_params.get("competition"))
    return principal


def get_reader(principal: Annotated[Principal | None, Depends(get_optional_principal)]) -> Principal:
    """Return who reads; without a token a visitor, who may see what is public."""
    return principal or VISITOR


MAX_NUMBER: Final = 2_147_483_647
"""The largest that a column of numbers holds; the database ends a request with a larger one by an error."""

RowNumber = Annotated[int, Path(ge=1, le=MAX_NUMBER)]
ServicesOf = Annotated[Services, Depends(get_services)]
ChangingServicesOf = Annotated[Services, Depends(get_changing_services)]
SignedInOf = Annotated[Principal, Security(get_principal, scopes=[Audience.SIGNED_IN])]
TeamOf = Annotated[Principal, Security(get_principal, scopes=[Audience.TEAMS])]
SubmitterOf = Annotated[Principal, Security(get_principal, scopes=[Audience.SUBMITTERS])]
ReaderOf = Annotated[Principal, Security(get_principal, scopes=[Audience.READERS])]
OwnerOf = Annotated[Principal, Security(get_principal, scopes=[Audience.OWNERS])]
CaptainOf = Annotated[Principal, Security(get_principal, scopes=[Audience.CAPTAINS])]
JudgeOf = Annotated[Principal, Security(get_principal, scopes=[Audience.JUDGES])]
CompetitionOrganizerOf = Annotated[Principal, Security(get_principal, scopes=[Audience.COMPETITION_ORGANIZERS])]
OrganizerOf = Annotated[Principal, Security(get_principal, scopes=[Audience.ORGANIZERS])]
VisitorOf = Annotated[Principal, Security(get_reader, scopes=[Audience.EVERYBODY])]
PublicReaderOf = Annotated[Principal, Security(get_reader, scopes=[Audience.READERS, Audience.EVERYBODY])]
"""Who reads a thing that its team may let everybody see."""
OptionalPrincipalOf = Annotated[Principal | None, Security(get_optional_principal, scopes=[Audience.EVERYBODY])]


def get_client_address(connection: HTTPConnection) -> str:
    """Return whom limits per address count for."""
    return client_key(connection.client.host if connection.client is not None else None)


def note_registration(request: Request) -> None:
    """Count an attempt to register or to join a team.

    Raises:
        ServiceError: there were too many from this address.
    """
    request.app.state.registration_limiter.note(get_client_address(request), "registrations from one address")


def note_password(request: Request, team: str, member: str, *, device: str | None = None) -> float:
    """Count an attempt to give a member's password, and return how long it has to wait [s].

    Args:
        request: from which address.
        team: name as it was given.
        member: likewise.
        device: on which that member has signed in before; None: none.

    Raises:
        ServiceError: there were too many.
    """
    wait_s: float = request.app.state.sign_in_limiters.note(
        get_client_address(request), member_key(team, member), device=device
    )
    return wait_s


def member_key(team: str, member: str) -> str:
    """Return what is equal for all ways to write the names of a team and its member."""
    return f"{teams.name_key(team)}\n{teams.name_key(member)}"
