"""Routes of the members of teams, and of what organizers decide about teams."""

from datetime import timedelta
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Request, Response
from pydantic import Field
from sqlalchemy.orm import Session

from ..accounts import members, merging, passwords, quotas, teams, tokens, webhooks
from ..accounts.messages import TITLE_LENGTH, find_receiver, make_announcement_view, publish_announcement
from ..accounts.passwords import MAX_LENGTH, MIN_LENGTH
from ..accounts.shown_names import ShownNames
from ..accounts.team_lists import change_note
from ..competitions.competition import Competition
from ..competitions.view import disqualified_since_the_end
from ..database.models import Team
from ..database.states import NoticeKind, Quota
from ..errors import not_found
from ..names import TEXT_LENGTH
from ..operations import team_data
from ..principals import CONSOLE, Principal
from ..services import Services
from ..views.correspondence import AnnouncementView, NewWebhookView, WebhookListView
from ..views.team_data import TeamDataView
from ..views.teams import (
    DisqualifiedView,
    NewInvitationView,
    NewTokenView,
    OrganizerTeamView,
    OwnTeamView,
    QuotaView,
    RegisteredTeamView,
)
from .access import (
    MAX_NUMBER,
    CaptainOf,
    ChangingServicesOf,
    CompetitionOrganizerOf,
    OrganizerOf,
    OwnerOf,
    ServicesOf,
    note_password,
    note_registration,
)
from .inputs import Input
from .middleware.shares import leave_place
from .problems import RESPONSES
from .teams import ONE_LINE

router = APIRouter(prefix="/teams", tags=["teams"], responses=RESPONSES)

EMAIL = r"^[A-Za-z0-9!#$%&'*+/^_`{|}~-]+(\.[A-Za-z0-9!#$%&'*+/^_`{|}~-]+)*@[A-Za-z0-9-]+(\.[A-Za-z0-9-]+)*$"
"""One plain address: nothing with which a header would name two, or none."""
Email = Annotated[str, Field(max_length=254, pattern=EMAIL)]
Password = Annotated[str, Field(min_length=MIN_LENGTH, max_length=MAX_LENGTH)]


class NewMember(Input):
    """Somebody who joins a team."""

    code: str = Field(max_length=200, description="Of the captain's invitation.")
    name: str = Field(min_length=2, max_length=teams.NAME_LENGTH, description="For the team and the organizers.")
    email: Email | None = Field(default=None, description="For notices.")
    password: Password | None = Field(default=None, description="To sign in on the pages, besides the token.")


class MemberChanges(Input):
    """What changes of a member; what is left out stays, null takes it away."""

    email: Email | None = None
    email_code: str | None = Field(default=None, max_length=200, description="Of the e-mail that asks to confirm.")
    password: Password | None = None
    old_password: str | None = Field(default=None, max_length=MAX_LENGTH, description="The one that it replaces.")
    muted: list[NoticeKind] | None = Field(default=None, max_length=20, description="Notices that are not wanted.")


class NewWebhook(Input):
    """Where notices are sent."""

    address: str = Field(max_length=500, description="An https address of the internet.")


class NewCaptain(Input):
    """Who leads the team from now on."""

    member_id: UUID


class TeamChanges(Input):
    """What an organizer changes of a team; what is left out stays."""

    name: str | None = Field(default=None, min_length=2, max_length=teams.NAME_LENGTH)
    accepted: bool | None = Field(default=None, description="The answer to a team that waits.")
    reason: str | None = Field(
        default=None, max_length=teams.REASON_LENGTH, pattern=ONE_LINE, description="Why it is not accepted."
    )


class Note(Input):
    """What organizers write about a team for each other."""

    note: str = Field(max_length=TEXT_LENGTH, description="Plain text; empty: no note.")


class NewMessage(Input):
    """What organizers say to one team."""

    title: str = Field(min_length=2, max_length=TITLE_LENGTH)
    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="Plain text.")
    competition: str | None = Field(default=None, description="Which competition it is about; null: the whole service.")


class TeamDisqualification(Input):
    """Why a team no longer takes part."""

    reason: str = Field(max_length=teams.REASON_LENGTH, pattern=ONE_LINE, description="The team reads it.")


class Limit(Input):
    """What a team may have of something."""

    limit: int | None = Field(ge=0, le=MAX_NUMBER, description="Null: any number.")


class Merge(Input):
    """The team into which another one is merged."""

    into: str = Field(pattern=ONE_LINE, max_length=200, description="Name or id of the team that remains.")


@router.post("/join", status_code=HTTPStatus.CREATED)
def join_team(request: Request, services: ChangingServicesOf, new: NewMember) -> RegisteredTeamView:
    """Join a team with the code of an invitation; the token is shown this once."""
    note_registration(request)
    leave_place(request)
    password = new.password and passwords.UNKNOWN_DEVICES.run(passwords.hashed, new.password)
    joining = members.JoiningMember(**new.model_dump(exclude={"password"}), password_hash=password)
    with services.database.transaction() as session:
        member, issued = members.join(session, joining, _lifetime(services))
        return RegisteredTeamView(
            team=teams.team_view(member.team, ShownNames.read(session, CONSOLE)),
            token=tokens.new_token_view(issued),
            waits_for_approval=member.team.approved_at is None,
        )


@router.get("/{team_id}")
def get_team(services: ServicesOf, principal: OwnerOf, team_id: UUID) -> OwnTeamView:
    """Return a team with its members and open invitations."""
    with services.database.transaction() as session:
        return members.own_team_view(session, principal, _team(session, principal, team_id))


@router.get("/{team_id}/data")
def get_team_data(services: ServicesOf, principal: OwnerOf, team_id: UUID) -> TeamDataView:
    """Return all data that the service stores about the team."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        return team_data.export(session, services.settings, principal, team)


@router.delete("/{team_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_team(services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID) -> None:
    """Remove a team's name, people, texts and uploads permanently; scores stay. For organizers."""
    with services.database.transaction() as session:
        team_data.erase(session, principal, _team(session, principal, team_id))


@router.patch("/{team_id}")
def change_team(
    services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, changes: TeamChanges
) -> OwnTeamView:
    """Rename a team, or accept or refuse one that waits; for organizers."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        if changes.name is not None:
            teams.rename(session, principal, team, changes.name)
        if changes.accepted is not None:
            if changes.accepted:
                teams.accept(session, principal, team)
            else:
                teams.refuse(session, principal, team, changes.reason or "")
        return members.own_team_view(session, principal, team)


@router.put("/{team_id}/note", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def put_note(services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, new: Note) -> None:
    """Keep a note about a team for organizers, in place of the one before."""
    with services.database.transaction() as session:
        change_note(session, principal, _team(session, principal, team_id), new.note)


@router.post("/{team_id}/messages", status_code=HTTPStatus.CREATED)
def post_message(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, team_id: UUID, new: NewMessage
) -> AnnouncementView:
    """Send a message to one team: its members read it on the page of announcements, and get it as a notice.

    An organizer of one competition reaches the teams with a submission to it, by their ids.
    """
    with services.database.transaction() as session:
        team = find_receiver(session, principal, team_id)
        return make_announcement_view(
            publish_announcement(session, principal, **new.model_dump(), notify=True, team=team)
        )


@router.put("/{team_id}/disqualification")
def disqualify_team(
    services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, wanted: TeamDisqualification
) -> DisqualifiedView:
    """Remove a team from all boards and refuse its submissions, until it is reinstated."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        teams.disqualify(session, principal, team, wanted.reason)
        session.flush()
        final = [out for one in Competition.read_all(session) for out in disqualified_since_the_end(one)]
        return DisqualifiedView(
            **dict(teams.organizer_team_view(session, team)),
            is_in_final_results=any(out.team == team.name for out in final),
        )


@router.delete("/{team_id}/disqualification")
def reinstate_team(services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID) -> OrganizerTeamView:
    """Let a disqualified team take part again, with all its results."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        teams.reinstate(session, principal, team)
        return teams.organizer_team_view(session, team)


@router.get("/{team_id}/quotas")
def list_quotas(services: ServicesOf, principal: OwnerOf, team_id: UUID) -> list[QuotaView]:
    """List the quotas of a team and how much of each is used."""
    with services.database.transaction() as session:
        return quotas.uses(session, services.settings.quotas, _team(session, principal, team_id).id)


@router.put("/{team_id}/quotas/{quota}")
def set_quota(
    services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, quota: Quota, wanted: Limit
) -> QuotaView:
    """Give a team a limit of its own."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        quotas.set_quota(session, principal, team, quota, wanted.limit)
        return _quota_view(session, services, team, quota)


@router.delete("/{team_id}/quotas/{quota}")
def reset_quota(services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, quota: Quota) -> QuotaView:
    """Give a team the limit of the service's settings again."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        quotas.reset_quota(session, principal, team, quota)
        return _quota_view(session, services, team, quota)


@router.post("/{team_id}/merge")
def merge_team(services: ChangingServicesOf, principal: OrganizerOf, team_id: UUID, merge: Merge) -> OwnTeamView:
    """Merge a team with another one, which keeps its name; for organizers."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        into = teams.find_as_organizer(session, principal, merge.into)
        merging.merge(session, principal, team, into)
        return members.own_team_view(session, principal, into)


@router.post("/{team_id}/invitations", status_code=HTTPStatus.CREATED)
def invite_member(services: ChangingServicesOf, principal: CaptainOf, team_id: UUID) -> NewInvitationView:
    """Make a code with which one person joins the team; it is shown this once."""
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        leads = principal.organizes_service and members.is_unclaimed(session, team)
        return members.new_invitation_view(*members.invite(session, principal, team, leads=leads))


@router.delete("/{team_id}/invitations/{invitation_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def withdraw_invitation(services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, invitation_id: UUID) -> None:
    """End an invitation that nobody has used."""
    with services.database.transaction() as session:
        members.withdraw_invitation(session, principal, _team(session, principal, team_id), invitation_id)


@router.put("/{team_id}/captain")
def change_captain(services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, new: NewCaptain) -> OwnTeamView:
    """Make another member the captain."""
    with services.database.transaction() as session:
        member = members.find(session, principal, team_id, new.member_id)
        members.hand_over(session, principal, member)
        return members.own_team_view(session, principal, member.team)


@router.patch("/{team_id}/members/{member_id}")
def change_member(
    request: Request,
    services: ChangingServicesOf,
    principal: CaptainOf,
    team_id: UUID,
    member_id: UUID,
    changes: MemberChanges,
) -> OwnTeamView:
    """Change the own e-mail address or password; a new password signs out all browsers that used the old one."""
    if "password" in changes.model_fields_set:
        note_password(request, str(team_id), str(member_id), device="token")
        leave_place(request)
        passwords.KNOWN_DEVICES.run(
            members.set_password,
            services.database,
            principal,
            team_id,
            member_id,
            changes.password,
            old=changes.old_password,
        )
    with services.database.transaction() as session:
        member = members.find(session, principal, team_id, member_id)
        if "email" in changes.model_fields_set:
            members.set_email(session, principal, member, changes.email)
        if changes.email_code is not None:
            members.confirm_email(session, principal, member, changes.email_code)
        if changes.muted is not None:
            members.mute(session, principal, member, changes.muted)
        return members.own_team_view(session, principal, member.team)


@router.get("/{team_id}/webhooks")
def list_webhooks(services: ServicesOf, principal: CaptainOf, team_id: UUID) -> WebhookListView:
    """Return the team's webhooks; for its captain."""
    with services.database.transaction() as session:
        return WebhookListView(items=webhooks.list_webhooks(session, principal, _team(session, principal, team_id)))


@router.post("/{team_id}/webhooks", status_code=HTTPStatus.CREATED)
def add_webhook(
    request: Request, services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, new: NewWebhook
) -> NewWebhookView:
    """Have the team's notices sent to an address; the secret that signs them is shown this once."""
    inside = services.settings.webhooks_may_lead_inside
    if not inside:
        leave_place(request)
        webhooks.require_public(new.address)
    with services.database.transaction() as session:
        team = _team(session, principal, team_id)
        return webhooks.add(session, principal, team, new.address, inside_allowed=inside)


@router.delete("/{team_id}/webhooks/{webhook_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def remove_webhook(services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, webhook_id: UUID) -> None:
    """Send no further notices to an address."""
    with services.database.transaction() as session:
        webhooks.remove(session, principal, _team(session, principal, team_id), webhook_id)


@router.delete("/{team_id}/members/{member_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def remove_member(services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, member_id: UUID) -> None:
    """Leave the team, or as its captain remove a member; their token ends at once."""
    with services.database.transaction() as session:
        members.remove(session, principal, members.find(session, principal, team_id, member_id))


@router.post("/{team_id}/members/{member_id}/token", status_code=HTTPStatus.CREATED)
def renew_member_token(
    services: ChangingServicesOf, principal: CaptainOf, team_id: UUID, member_id: UUID
) -> NewTokenView:
    """Get a new token in place of the own one, which ends; the secret is shown this once."""
    with services.database.transaction() as session:
        member = members.find(session, principal, team_id, member_id)
        return tokens.new_token_view(members.renew_token(session, principal, member, _lifetime(services)))


def _team(session: Session, by: Principal, team_id: UUID) -> Team:
    team = session.get(Team, team_id)
    if team is None or not by.may_change(team_id):
        raise not_found("team", team_id)
    return team


def _quota_view(session: Session, services: Services, team: Team, quota: Quota) -> QuotaView:
    used = quotas.uses(session, services.settings.quotas, team.id)
    return next(use for use in used if use.quota == quota)


def _lifetime(services: Services) -> timedelta:
    return timedelta(days=services.settings.token_lifetime_days)
