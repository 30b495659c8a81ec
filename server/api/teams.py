"""Routes of teams and tokens."""

from datetime import timedelta
from http import HTTPStatus
from typing import Annotated, Literal, cast
from uuid import UUID

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from sqlalchemy.orm import Session

from ..accounts import messages, registration, team_lists, teams, tokens
from ..accounts.quotas import charge, stage_uses, uses
from ..accounts.shown_names import ShownNames
from ..database.models import ApiToken, Team
from ..database.states import Quota, Role
from ..errors import ProblemCode, ServiceError
from ..names import TEXT_LENGTH
from ..principals import CONSOLE, Principal
from ..services import Services
from ..views.teams import (
    ImportedTeamView,
    ListedTeamView,
    MeView,
    NewTokenView,
    OrganizerTeamView,
    QuotaView,
    RegisteredTeamView,
    TeamState,
    TokenListView,
)
from .access import (
    CaptainOf,
    ChangingServicesOf,
    OptionalPrincipalOf,
    OrganizerOf,
    ServicesOf,
    SignedInOf,
    SubmitterOf,
    note_registration,
)
from .inputs import Input
from .problems import RESPONSES

router = APIRouter(tags=["teams"], responses=RESPONSES)

ONE_LINE = r"^[^\x00-\x1f\x7f]+$"
Label = Annotated[str, Field(min_length=1, max_length=64, pattern=ONE_LINE)]


class NewTeam(Input):
    """A team that wants to take part."""

    name: str = Field(min_length=1, max_length=teams.NAME_LENGTH, description="Shown on the leaderboard.")
    contact: str | None = Field(
        default=None, max_length=teams.CONTACT_LENGTH, pattern=ONE_LINE, description="For the organizers."
    )
    invite: str | None = Field(default=None, max_length=200, description="The invite code, where one is needed.")


class NewToken(Input):
    """A further token."""

    label: Label = Field(description="Distinguishes the tokens of a team.")
    expires_in_days: int | None = Field(default=None, ge=1, le=3650, description="The server's default if null.")
    team: str | None = Field(default=None, pattern=ONE_LINE, description="For organizers: whose token this is.")
    role: Literal[Role.ORGANIZER, Role.JUDGE] | None = Field(
        default=None, description="For organizers: of a token without a team. The label of a judge's is their name."
    )
    competition: str | None = Field(
        default=None, max_length=100, description="The only competition that an organizer's token is for."
    )


class TeamsFile(Input):
    """A file with teams."""

    csv: str = Field(
        max_length=1_000_000,
        description="CSV with a line of names of columns: name and, if wanted, contact; others become the note.",
    )


class ChangeOfTeams(Input):
    """What is done with several teams at once."""

    action: team_lists.BulkAction
    reason: str | None = Field(
        default=None, max_length=teams.REASON_LENGTH, pattern=ONE_LINE, description="Of a refusal or disqualification."
    )
    title: str | None = Field(default=None, max_length=messages.TITLE_LENGTH, description="Of a message.")
    text: str | None = Field(default=None, max_length=TEXT_LENGTH, description="Of a message: plain text.")
    teams: list[str] = Field(min_length=1, max_length=1000, description="Names or ids.")


@router.post("/teams", status_code=HTTPStatus.CREATED)
def post_team(
    request: Request, services: ChangingServicesOf, principal: OptionalPrincipalOf, new: NewTeam
) -> RegisteredTeamView:
    """Register a team and give it its first token. The secret is shown this once."""
    if principal is None or not principal.organizes_service:
        note_registration(request)
    with services.database.transaction() as session:
        team, issued = registration.register(
            session, services.settings, principal, registration.RegisteringTeam(**new.model_dump())
        )
        return RegisteredTeamView(
            team=teams.team_view(team, ShownNames.read(session, CONSOLE)),
            token=tokens.new_token_view(issued),
            waits_for_approval=team.approved_at is None,
        )


@router.get("/teams")
def list_teams(
    services: ServicesOf,
    principal: OrganizerOf,
    *,
    state: Annotated[TeamState | None, Query(description="Only teams in this state.")] = None,
    search: Annotated[str, Query(max_length=64, description="Only teams with this in name, contact or note.")] = "",
    competition: Annotated[str | None, Query(description="Only teams with a submission to this competition.")] = None,
    name: Annotated[str | None, Query(description="Only the team of this name or id.")] = None,
) -> list[ListedTeamView]:
    """List all teams, or some of them."""
    wanted = team_lists.TeamSearch(text=search, state=state, competition=competition)
    with services.database.transaction() as session:
        only = teams.find(session, name).id if name is not None else None
        listed = team_lists.list_teams(session, principal, wanted)
        return [team for team in listed if only in {None, team.id}]


@router.post("/teams/import", status_code=HTTPStatus.CREATED)
def import_teams(services: ChangingServicesOf, principal: OrganizerOf, new: TeamsFile) -> list[ImportedTeamView]:
    """Add the teams of a CSV file, accepted and each with an invitation for its captain; all of them or none."""
    with services.database.transaction() as session:
        made = team_lists.import_teams(session, principal, new.csv)
        is_trial = services.database.is_trial
        return [one.model_copy(update={"code": None}) for one in made] if is_trial else made


@router.post("/teams/changes")
def change_teams(
    services: ChangingServicesOf, principal: OrganizerOf, change: ChangeOfTeams
) -> list[OrganizerTeamView]:
    """Do the same with several teams, all or none: accept, refuse, disqualify, reinstate, or send a message."""
    with services.database.transaction() as session:
        changed = team_lists.change_teams(
            session,
            principal,
            change.teams,
            change.action,
            reason=change.reason or "",
            title=change.title or "",
            text=change.text or "",
        )
        return [teams.organizer_team_view(session, team) for team in changed]


@router.post("/tokens", status_code=HTTPStatus.CREATED)
def post_token(services: ChangingServicesOf, principal: SubmitterOf, new: NewToken) -> NewTokenView:
    """Make a further token of the own team; an organizer's without `team` is an organizer's token."""
    with services.database.transaction() as session:
        owner = _owner_of_new_token(session, principal, new)
        if owner is not None:
            charge(session, services.settings.quotas, principal, owner, Quota.TOKENS)
        issued = tokens.issue(
            session,
            principal,
            role=Role.TEAM if owner is not None else new.role or Role.ORGANIZER,
            label=new.label,
            team=owner,
            competition=new.competition,
            lifetime=_lifetime(services, new.expires_in_days),
        )
        return tokens.new_token_view(issued)


@router.get("/tokens")
def list_tokens(services: ServicesOf, principal: SignedInOf) -> TokenListView:
    """Return the team's tokens, without secrets; all for an organizer."""
    with services.database.transaction() as session:
        return TokenListView(items=[tokens.token_view(token) for token in tokens.list_tokens(session, principal)])


@router.delete("/tokens/{token_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_token(services: ChangingServicesOf, principal: CaptainOf, token_id: UUID) -> None:
    """Revoke a token."""
    with services.database.transaction() as session:
        tokens.revoke(session, principal, token_id)


@router.get("/me")
def get_me(services: ServicesOf, principal: SignedInOf) -> MeView:
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
    if new.team is not None and new.role is not None:
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Give one of team and role: a team's token has no other role.")
    if new.competition is not None and new.role is not Role.ORGANIZER:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, "Only an organizer's token is for one competition: give its role, too."
        )
    if new.team is not None:
        return teams.find_as_organizer(session, principal, new.team)
    return None if principal.organizes_service or new.role is not None else teams.own(session, principal)


def _quotas(session: Session, services: Services, principal: Principal) -> list[QuotaView]:
    if principal.team_id is None:
        return []
    return uses(session, services.settings.quotas, principal.team_id)


def _lifetime(services: Services, days: int | None) -> timedelta:
    return timedelta(days=days or services.settings.token_lifetime_days)
