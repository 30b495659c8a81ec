"""Teams and tokens as they are shown."""

from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import Field

from ..db.states import Quota, Role
from .base import View


class TeamView(View):
    """A team."""

    id: UUID
    name: str
    created_at: datetime


class OrganizerTeamView(TeamView):
    """A team with what only organizers may know."""

    contact: str | None = Field(description="Where organizers reach the team.")
    disqualified_for: str | None = Field(description="Why the team no longer takes part; null: it does.")


class TokenView(View):
    """A token without its secret."""

    id: UUID
    label: str
    role: Role
    team: str | None
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None


class NewTokenView(TokenView):
    """A new token; the secret is shown this once and stored as a hash only."""

    secret: str


class RegisteredTeamView(View):
    """A new team with its first token."""

    team: TeamView
    token: NewTokenView


class QuotaView(View):
    """How much of a quota a team has used."""

    quota: Quota
    limit: int | None = Field(description="Null: any number.")
    used: int | None = Field(description="Null where it is not counted in one place.")
    opens_at: datetime | None = Field(description="When a daily quota counts from zero again.")


class MeView(View):
    """Who the token belongs to."""

    role: Role
    team: TeamView | None
    token: TokenView | None
    quotas: list[QuotaView] = Field(description="Of the team; empty for organizers and judges.")


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
