"""What the pages show of an episode and of its playback."""

from uuid import UUID

from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeOutcome

from ..database.states import WorkState
from .base import View


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
