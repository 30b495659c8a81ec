"""Teams and tokens as they are shown."""

from datetime import datetime
from enum import StrEnum
from typing import Any
from uuid import UUID

from pydantic import Field

from ..database.states import MemberRole, NoticeKind, Quota, Role
from .base import View


class TeamView(View):
    """A team."""

    id: UUID
    name: str
    shown_as: str = Field(description="The name that others see; until an anonymous competition is final a random one.")
    created_at: datetime | None = Field(description="When it registered; null where its name is hidden.")


class OrganizerTeamView(TeamView):
    """A team with what only organizers may know."""

    contact: str | None = Field(description="Where organizers reach the team.")
    disqualified_for: str | None = Field(description="Why the team no longer takes part; null: it does.")
    approved_at: datetime | None = Field(description="When it was accepted; null: it waits, or was refused.")
    refused_for: str | None = Field(description="Why it was not accepted; null: it was, or it waits.")


class TeamState(StrEnum):
    """Whether a team takes part."""

    WAITING = "waiting"
    """Until an organizer accepts it."""
    ACCEPTED = "accepted"
    REFUSED = "refused"
    DISQUALIFIED = "disqualified"
    REMOVED = "removed"
    """Its name and members are gone; its scores stay."""


class ListedTeamView(OrganizerTeamView):
    """A team in a list of organizers."""

    state: TeamState
    note: str = Field(description="What organizers write about it for each other.")
    members: int = Field(description="Present ones.")
    submissions: int


class ImportedTeamView(View):
    """A team of a file, with the invitation of its captain."""

    id: UUID
    name: str
    contact: str | None
    code: str | None = Field(description="Whoever joins with it leads the team; shown this once, null in a dry run.")
    expires_at: datetime


class DisqualifiedView(OrganizerTeamView):
    """A team that no longer takes part."""

    is_in_final_results: bool = Field(
        description="Whether it is struck through in final results; these can be decided again without it."
    )


class MemberView(View):
    """A member, as the team and organizers see it."""

    id: UUID
    name: str
    role: MemberRole
    email: str | None = Field(description="Where the member gets notices.")
    email_confirmed: bool = Field(
        description="Whether the code sent there was given back; before, nothing else is sent."
    )
    has_password: bool
    muted: list[NoticeKind] = Field(description="Kinds of notices that the member does not want.")
    joined_at: datetime
    left_at: datetime | None


class InvitationView(View):
    """An invitation that can still be used."""

    id: UUID
    created_at: datetime
    expires_at: datetime


class NewInvitationView(InvitationView):
    """A new invitation; its code is shown this once and stored as a hash only."""

    code: str


class OwnTeamView(OrganizerTeamView):
    """A team as its members and organizers see it."""

    members: list[MemberView]
    invitations: list[InvitationView]


class TokenView(View):
    """A token without its secret."""

    id: UUID
    label: str
    role: Role
    team: str | None
    member: str | None = Field(description="Whose token it is; null: shared by the team, or of an organizer or judge.")
    competition: str | None = Field(
        default=None, description="The only competition of an organizer's token; else null."
    )
    is_session: bool = Field(description="A browser that signed in with a password; nobody has a secret.")
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None


class NewTokenView(TokenView):
    """A new token; the secret is shown this once and stored as a hash only."""

    secret: str


class RegisteredTeamView(View):
    """A new team, or one that somebody has joined, with the new member's token."""

    team: TeamView
    token: NewTokenView
    waits_for_approval: bool = Field(description="Whether an organizer has to accept the team before it submits.")


class QuotaView(View):
    """How much of a quota a team has used."""

    quota: Quota
    limit: int | None = Field(description="Null: any number.")
    used: int | None = Field(description="Null where it is not counted in one place.")
    opens_at: datetime | None = Field(description="When a daily quota counts from zero again.")


class StageQuotaView(View):
    """How much of a quota of an open stage a team has used."""

    competition: str = Field(description="Name of the competition.")
    track: str
    stage: str
    closes: datetime
    quota: str
    limit: int | None = Field(description="Null: any number.")
    used: int


class MeView(View):
    """Who the token belongs to."""

    role: Role
    team: TeamView | None
    token: TokenView | None
    quotas: list[QuotaView] = Field(description="Of the team; empty for organizers and judges.")
    stage_quotas: list[StageQuotaView] = Field(
        description="Of the open stages of the competition that it takes part in."
    )


class TokenListView(View):
    """Tokens of a team, or all for an organizer."""

    items: list[TokenView]


class AuditEntryView(View):
    """A line of the audit log."""

    id: int
    at: datetime
    actor: str = Field(description="Who: a team, organizer or judge.")
    action: str = Field(description="What was done, `noun.verb`.")
    subject: str = Field(description="To which thing, `noun:id`.")
    before: dict[str, Any] | None = Field(description="Null where there was nothing before.")
    after: dict[str, Any]


class AuditDigestView(View):
    """The digest of some lines of the audit log in the public log."""

    entry: int = Field(description="Number of the entry in the public log.")
    issued_at: datetime
    first: int = Field(description="Number of the first line.")
    last: int = Field(description="Number of the last line.")
    lines: int
    lines_sha256: str = Field(description="Over the lines as canonical JSON.")
    agrees: bool = Field(description="Whether the audit log still has these lines, and no others between them.")
