"""Counts attempts to register and to sign in, those of API and pages together."""

from fastapi import Request
from starlette.requests import HTTPConnection

from ..accounts import teams
from ..limiter import client_key


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
