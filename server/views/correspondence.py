"""Announcements and questions as API and pages show them."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from ..database.states import AppealState, NoticeChannel, NoticeKind
from .base import View


class AnnouncementView(View):
    """What organizers say to everybody."""

    id: int
    competition: str | None = Field(default=None, description="Whose it is; null: of the whole service.")
    team: str | None = Field(default=None, description="To which team alone; null: to everybody.")
    title: str
    text: str = Field(description="Plain text.")
    published_at: datetime


class AnnouncementListView(View):
    """Announcements, newest first."""

    items: list[AnnouncementView]


class QuestionView(View):
    """A question to the organizers, with its answer."""

    id: int
    team: str | None = Field(description="Who asks; null for everybody but the team and organizers.")
    text: str = Field(description="Plain text.")
    public: bool = Field(description="Whether everybody sees it once it is answered.")
    asked_at: datetime
    answer: str | None = Field(description="Plain text; null: not answered yet.")
    answered_at: datetime | None
    hidden: bool = Field(description="Organizers answer it no longer, and show it to nobody else.")


class QuestionListView(View):
    """Questions, newest first."""

    items: list[QuestionView]


class AppealReplayView(View):
    """What an episode gave when it was played again, beside the stored result."""

    task: str
    episode: int
    policy_sha256: str = Field(description="SHA-256 of the archive that was played.")
    corrected: bool = Field(description="Whether that is another one than the submission's.")
    outcome: str
    env_steps: int
    same_states: bool = Field(description="Whether every env step had the state of the stored record.")
    failure: str | None = Field(description="Why the policy failed in it; null where it did not.")
    old_outcome: str
    old_env_steps: int
    played_at: datetime


class AppealView(View):
    """An appeal against an evaluation."""

    id: int
    team: str
    submission_id: UUID
    submission_name: str
    track: str
    evaluation_id: UUID
    task: str | None = Field(description="Null: all of the evaluation.")
    episode: int | None
    text: str = Field(description="Plain text.")
    state: AppealState
    ruling: str | None
    opened_at: datetime
    ended_at: datetime | None
    replays: list[AppealReplayView]


class AppealListView(View):
    """Appeals, newest first."""

    items: list[AppealView]


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
