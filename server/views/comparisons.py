"""Results beside each other, as API, pages and commands show them."""

from datetime import datetime
from uuid import UUID

from pydantic import Field
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeOutcome

from ..database.states import WorkState
from .base import View
from .scores import STARTS, PlayedScoreView, RateView, TaskScoreView


class ComparedResultView(View):
    """One of the results that are compared."""

    submission_id: UUID
    submission_name: str
    team: str
    track: str
    submitted_at: datetime
    evaluator_version: str
    played: PlayedScoreView | None
    scores: list[TaskScoreView]
    has_page: bool = Field(description="The reader may see its submission; of others only what a leaderboard shows.")
    episodes: int = Field(description="Number of single episodes that the reader may see; 0 where none are shown.")


class ComparedGroupView(View):
    """The same episodes of a task as all results played them."""

    task: str
    name: str = Field(description="The shape, or how far from their targets these episodes start.")
    is_shape: bool
    rates: list[RateView | None] = Field(description="In the order of the results; null where it is not known.")


class ComparedPairView(View):
    """Two of the results in a task, on the episodes that both have: exact permutation test over the starts."""

    task: str
    first: int = Field(description="Place in the list of results, from 0.")
    second: int
    both: int
    only_first: int
    only_second: int
    neither: int
    unpaired: int = Field(description="Episodes that only one of them has, or that began elsewhere: left out.")
    starts: int = Field(description=STARTS)
    difference: float = Field(description="Success rate of the first minus that of the second.")
    difference_interval: tuple[float, float] = Field(description="95 % interval of that, by start.")
    p_value: float = Field(description="How likely a difference at least as large is if both are equally good.")
    adjusted_p_value: float = Field(description="The same, adjusted for the number of pairs in the task (Holm).")


class ComparedEndView(View):
    """How an episode ended in one of the results."""

    outcome: str
    success: bool
    env_steps: int


class ComparedEpisodeView(View):
    """An episode that some of the results solve and others do not."""

    task: str
    episode: int
    shape: str
    ends: list[ComparedEndView | None] = Field(description="In the order of the results; null where it is not shown.")


class ComparisonView(View):
    """Results beside each other: by shape, by difficulty, in pairs, and the episodes in which they differ."""

    results: list[ComparedResultView]
    groups: list[ComparedGroupView]
    pairs: list[ComparedPairView]
    differing: list[ComparedEpisodeView]


class PlaybackView(View):
    """A playback that somebody asked for.

    `waits_for` counts the playbacks before it while it is queued; `workers` those that could make it while
    it is not finished, which can run `family`; `problem` says why there is none.
    """

    key: str
    state: WorkState
    env_steps: int
    env_steps_played: int
    waits_for: int
    family: Family
    workers: int | None
    problem: str | None
    has_cameras: bool
    has_still: bool


class StoryMomentView(View):
    """A mark on an episode's time line: what had happened after an env step."""

    env_step: int
    mark: str
    text: str


class ShownEpisodeView(View):
    """A finished episode on its page; `playback` is None as long as nobody has asked for it.

    `story` says in a sentence what happened, `moments` when.
    """

    submission_name: str
    team: str
    track: str
    task: str
    episode: int
    shape: str
    initial_offset: tuple[float, ...]
    outcome: EpisodeOutcome
    env_steps: int
    total_reward: float
    story: str
    moments: tuple[StoryMomentView, ...]
    evaluator_version: str
    record_digest: str
    playback: PlaybackView | None


class EpisodeChoiceView(View):
    """A finished episode that can be shown beside another one; `label` says whose it is."""

    submission_id: UUID
    episode: int
    label: str
    outcome: EpisodeOutcome


class StillView(View):
    """An episode of a result whose playback has a still; `key` is that of the playback."""

    task: str
    episode: int
    outcome: EpisodeOutcome
    key: str


class PublicEpisodeView(View):
    """A finished episode of a public submission, with its playback."""

    submission_id: UUID
    shown: ShownEpisodeView
