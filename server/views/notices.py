"""Webhooks and notices to teams as API and pages show them."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from ..database.states import NoticeChannel, NoticeKind
from .base import View


class WebhookView(View):
    """A webhook without its secret."""

    id: UUID
    address: str
    created_at: datetime


class NewWebhookView(WebhookView):
    """A new webhook; its secret is shown this once."""

    secret: str = Field(description="Key of the signature in the header `Vitac-Signature`.")


class WebhookListView(View):
    """The webhooks of a team."""

    items: list[WebhookView]


class NoticeView(View):
    """A notice, as organizers see it."""

    id: UUID
    kind: NoticeKind
    subject: str = Field(description="Of which thing, `noun:id`.")
    channel: NoticeChannel
    target: str = Field(description="The address of an e-mail, or the id of a webhook.")
    created_at: datetime
    due_at: datetime
    attempts: int
    sent_at: datetime | None
    given_up_at: datetime | None
    problem: str | None = Field(description="Why the last try failed.")
