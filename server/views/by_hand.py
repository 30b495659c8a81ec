"""Briefs that a committee judges, and boards of results that operators enter."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from .base import View


class BriefView(View):
    """A team's brief and what the committee decided of it."""

    team: str
    team_id: UUID
    sha256: str
    pages: int
    received_at: datetime
    accepted: bool | None = Field(description="Whether the team advances; null before the decision.")
    reason: str
    decided_at: datetime | None


class BriefListView(View):
    """Briefs of a stage, in the order of their arrival."""

    items: list[BriefView]


class EnteredTaskView(View):
    """A task that is played elsewhere."""

    name: str
    title: str
    prompt: str = Field(description="The task in words, as the policy gets it.")
    points: int = Field(description="Most points of an attempt.")


class EnteredEntryView(View):
    """The best attempt of a team, or of a baseline, which has no rank and wins nothing."""

    rank: int | None
    team: str
    is_baseline: bool
    attempt: int = Field(description="Which one counts, from 1.")
    attempts: int = Field(description="How many were entered.")
    points: dict[str, float] = Field(description="Of each task.")
    total: float
    evidence: str
    entered_at: datetime
    prize: str | None = Field(description="What the rank wins, once the stage has closed; null: nothing.")


class EnteredBoardView(View):
    """The board of a stage whose results operators enter, best first."""

    competition: str
    track: str
    stage: str
    tasks: list[EnteredTaskView]
    entries: list[EnteredEntryView]
