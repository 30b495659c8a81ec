"""Tracks as they are shown."""

from pydantic import Field
from vitac.evaluator.submission_kinds import SubmissionKind

from .base import View


class TrackTaskView(View):
    """One task of a track."""

    name: str
    title: str
    env_id: str
    episodes: int
    max_steps: int


class TrackView(View):
    """A track that can be submitted to."""

    name: str
    title: str
    summary: str
    ranking_rule: str = Field(description="Order on the leaderboard of a task.")
    combination_rule: str | None = Field(description="Order on the leaderboard of all tasks; null where there is one.")
    accepts: list[SubmissionKind] = Field(description="What may be submitted.")
    tasks: list[TrackTaskView]
    log_bytes: int = Field(description="Largest log that may be uploaded, packed and unpacked.")
    limits: dict[str, float] = Field(description="Most that an upload and its policy may use; bytes, seconds, numbers.")


class TrackListView(View):
    """All tracks."""

    items: list[TrackView]
