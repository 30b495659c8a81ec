"""A trial of a station as its page shows it."""

from uuid import UUID

from pydantic import Field
from vitac.evaluator.episodes.records import ContactForces, EpisodeOutcome, HumanHelp, TrialVideo

from .base import View


class TrialMomentView(View):
    """What was measured after an env step."""

    env_step: int
    frame: int | None = Field(description="Of the video, from 1; null without one.")
    encoders: tuple[float, float, float, float] = Field(description="Pose of the stage: x, y, z [mm], rotation [deg].")
    movement_px: tuple[float, float] = Field(description="Mean movement of the markers on the left and right gel.")


class TrialView(View):
    """A trial that a station has played."""

    submission_id: UUID
    submission_name: str
    team: str
    track: str
    task: str
    episode: int
    station: str
    twin: str | None = Field(description="What kind of twin the station was then, in words; null for hardware.")
    shape: str
    initial_offset: tuple[float, ...]
    outcome: EpisodeOutcome
    env_steps: int
    moments: tuple[TrialMomentView, ...]
    forces: ContactForces | None
    help: tuple[HumanHelp, ...] = Field(description="How people helped in the trial, and since the one before.")
    video: TrialVideo | None
    evaluator_version: str
    record_digest: str
