"""Appeals as API and pages show them."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from ..database.states import AppealState
from .base import View


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
