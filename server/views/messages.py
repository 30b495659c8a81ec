"""Announcements and questions as API and pages show them."""

from datetime import datetime

from pydantic import Field

from .base import View


class AnnouncementView(View):
    """What organizers say to everybody."""

    id: int
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
