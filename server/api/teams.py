"""Routes of teams and tokens."""

from datetime import timedelta
from http import HTTPStatus
from typing import Annotated, cast
from uuid import UUID

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session

from .. import tokens
from ..db.models import ApiToken, Team
from ..db.states import Quota, Role
from ..members import registration
from ..principals import CONSOLE, Principal
from ..quotas import charge, stage_uses, uses
from ..services import Services
from ..teams import teams
from ..teams.shown_names import ShownNames
from ..views.teams import MeView, NewTokenView, QuotaView, RegisteredTeamView, TokenListView
from .access import OptionalPrincipalOf, PrincipalOf, ServicesOf
from .attempts import note_registration
from .problems import RESPONSES

router = APIRouter(tags=["teams"], responses=RESPONSES)

ONE_LINE = r"^[^\x00-\x1f\x7f]+$"
Label = Annotated[str, Field(min_length=1, max_length=64, pattern=ONE_LINE)]


class NewTeam(BaseModel):
    """A team that wants to take part."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1, max_length=teams.NAME_LENGTH, description="Shown on the leaderboard.")
    contact: str | None = Field(
        default=None, max_length=teams.CONTACT_LENGTH, pattern=ONE_LINE, description="For the organizers."
    )
    invite: str | None = Field(default=None, max_length=200, description="The invite code, where one is needed.")


class NewToken(BaseModel):
    """A further token."""

    model_config = ConfigDict(extra="forbid")
    label: Label = Field(description="Distinguishes the tokens of a team.")
    expires_in_days: int | None = Field(default=None, ge=1, le=3650, description="The server's default if null.")
    team: str | None = Field(default=None, pattern=ONE_LINE, description="For organizers: whose token this is.")


@router.post("/teams", status_code=HTTPStatus.CREATED)
def post_team(
    request: Request, services: ServicesOf, principal: OptionalPrincipalOf, new: NewTeam
) -> RegisteredTeamView:
    """Register a team and give it its first token. The secret is shown this once."""
    if principal is None or not principal.is_organizer:
        note_registration(request)
    with services.database.transaction() as session:
        team, issued = registration.register(
            session, services.settings, principal, registration.NewTeam(**new.model_dump())
        )
        return RegisteredTeamView(
            team=teams.team_view(team, ShownNames.read(session, CONSOLE)),
            token=tokens.new_token_view(issued),
            waits_for_approval=team.approved_at is None,
        )


@router.post("/tokens", status_code=HTTPStatus.CREATED)
def post_token(services: ServicesOf, principal: PrincipalOf, new: NewToken) -> NewTokenView:
    """Make a further token of the own team; an organizer's without `team` is an organizer's token."""
    with services.database.transaction() as session:
        owner = _owner_of_new_token(session, principal, new)
        if owner is not None:
            charge(session, services.settings.quotas, principal, owner, Quota.TOKENS)
        issued = tokens.issue(
            session,
            principal,
            role=Role.TEAM if owner is not None else Role.ORGANIZER,
            label=new.label,
            team=owner,
            lifetime=_lifetime(services, new.expires_in_days),
        )
        return tokens.new_token_view(issued)


@router.get("/tokens")
def list_tokens(services: ServicesOf, principal: PrincipalOf) -> TokenListView:
    """Return the team's tokens, without secrets; all for an organizer."""
    with services.database.transaction() as session:
        return TokenListView(items=[tokens.token_view(token) for token in tokens.list_tokens(session, principal)])


@router.delete("/tokens/{token_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_token(services: ServicesOf, principal: PrincipalOf, token_id: UUID) -> None:
    """Revoke a token."""
    with services.database.transaction() as session:
        tokens.revoke(session, principal, token_id)


@router.get("/me")
def get_me(services: ServicesOf, principal: PrincipalOf) -> MeView:
    """Return who the token belongs to and until when it is good."""
    with services.database.transaction() as session:
        token = session.get(ApiToken, principal.token_id)
        team = teams.own(session, principal) if principal.team_id is not None else None
        return MeView(
            role=cast("Role", principal.role),  # a visitor without a token does not come here
            team=teams.team_view(team, ShownNames.read(session, principal)) if team is not None else None,
            token=tokens.token_view(token) if token is not None else None,
            quotas=_quotas(session, services, principal),
            stage_quotas=stage_uses(session, team) if team else [],
        )


def _owner_of_new_token(session: Session, principal: Principal, new: NewToken) -> Team | None:
    if new.team is not None:
        return teams.find_as_organizer(session, principal, new.team)
    return None if principal.is_organizer else teams.own(session, principal)


def _quotas(session: Session, services: Services, principal: Principal) -> list[QuotaView]:
    if principal.team_id is None:
        return []
    return uses(session, services.settings.quotas, principal.team_id)


def _lifetime(services: Services, days: int | None) -> timedelta:
    return timedelta(days=days or services.settings.token_lifetime_days)
