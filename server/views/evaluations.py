"""Evaluations as they are shown: state, progress, verdict, score."""

from datetime import datetime
from uuid import UUID

from pydantic import Field
from vitac.evaluator.tracks import ListKind

from ..database.states import EvaluationState, RepeatCause, WorkState
from .base import View
from .scores import PlayedScoreView, PracticeScoreView, TaskScoreView


class TaskProgressView(View):
    """Finished episodes of one task."""

    task: str
    episodes_done: int
    episodes_total: int
    successes: int


class ProgressView(View):
    """Finished episodes of an evaluation."""

    episodes_done: int = Field(description="In tenths of the total before the end on a sealed list.")
    episodes_total: int
    episodes_reused: int = Field(
        description="Of the finished ones: those that were stored before this evaluation began; 0 where the team has "
        "not submitted this content before."
    )
    successes: int | None = Field(description="Null before the end on a sealed list.")
    tasks: list[TaskProgressView] = Field(description="None before the end on a sealed list.")


class VerdictView(View):
    """Why an evaluation has no score."""

    code: str = Field(description="Stable name, from a closed list.")
    title: str = Field(description="What this code means and what to do about it.")
    message: str = Field(description="What happened this time.")
    task: str | None
    episode: int | None


class EvaluationSummaryView(View):
    """A line of a submission's history."""

    id: UUID
    run: int
    state: EvaluationState
    evaluator_version: str
    created_at: datetime
    finished_at: datetime | None
    result_hash: str | None


class DifferingEpisodeView(View):
    """An episode that was played again with another record than the stored one, which counts.

    The policy or a machine does not repeat itself.
    """

    task: str
    episode: int
    stored_digest: str = Field(description="SHA-256 of the record that counts.")
    differing_digest: str = Field(description="SHA-256 of the record that was refused.")
    worker_id: UUID | None = Field(description="Whose record was refused.")
    seen_at: datetime


class CopyView(View):
    """A submission has the states, or nearly the actions or states, of an earlier submission of another team."""

    team: str = Field(description="Whose the earlier one is.")
    episodes: int = Field(description="Number of episodes that are alike.")
    of: int | None = Field(
        default=None, description="Of how many that say something; null: the states are exactly the same."
    )
    task: str | None = Field(default=None, description="In which task; null: the states are exactly the same.")
    sealed: bool = Field(default=False, description="Whether on a sealed list; else on the public one.")
    ranked: bool = Field(description="False with half of the episodes or more, unless it is cleared.")
    cleared_for: str | None = Field(default=None, description="Why an organizer has cleared it; null: nobody has.")

    @property
    def sentence(self) -> str:
        """What was found, and what follows."""
        if self.cleared_for is not None:
            return f"{self._found} An organizer has cleared it: {self.cleared_for}"
        if self.ranked:
            return f"{self._found} The earlier one stands."
        return (
            f"{self._found} The earlier one stands; this one keeps its score and is not ranked until an organizer has "
            "cleared it. If it is your own work, appeal or write to the organizers."
        )

    @property
    def _found(self) -> str:
        if self.of is None:
            return (
                f"{self.episodes} episodes have exactly the states of an earlier submission of {self.team}, half-way "
                "through or to the end."
            )
        return (
            f"{self.episodes} of {self.of} episodes of {self.task} on the {'sealed' if self.sealed else 'public'} list "
            f"are near those of an earlier submission of {self.team}: the same actions, commanded motion or states."
        )


class NearCopyView(View):
    """An evaluation that acts nearly as an earlier submission of another team, on one list; for organizers."""

    evaluation_id: UUID
    submission_id: UUID
    submission_name: str
    team: str
    earlier_submission_id: UUID
    earlier_submission_name: str
    earlier_team: str
    task: str
    sealed: bool = Field(description="Whether on a sealed list; else on the public one.")
    near: int = Field(description="Episodes whose actions, commanded motions or states are within the tolerance.")
    episodes: int = Field(description="Episodes that both have and that say something.")
    difference: float = Field(description="Median over the episodes of the largest difference of an action.")
    found_at: datetime
    code: float | None = Field(default=None, description="Share of the code of both archives that is in both.")
    weights: float | None = Field(default=None, description="Correlation of the weights in both archives.")


class ArchiveCopyView(View):
    """A model whose archive is alike to that of an earlier model of another team; for organizers."""

    submission_id: UUID
    submission_name: str
    team: str
    earlier_submission_id: UUID
    earlier_submission_name: str
    earlier_team: str
    track: str
    code: float | None = Field(description="Share of the code of both archives that is in both; null without code.")
    weights: float | None = Field(description="Correlation of the weights in both archives; null without weights.")
    found_at: datetime


class PackagesView(View):
    """The packages that a policy saw."""

    digest: str = Field(description="SHA-256 of the list; each shard names the one that its policy saw.")
    versions: dict[str, str] = Field(description="Versions by name.")


class EvaluationView(EvaluationSummaryView):
    """One run of the evaluator over a submission."""

    started_at: datetime | None
    queue_position: int | None = Field(description="1 is next; null unless queued.")
    sensor_check: WorkState | None = Field(
        default=None,
        description="Of the check of its sensor, before any episode; null where none is queued or running.",
    )
    eta_s: float | None = Field(description="Seconds to the end; null when finished or not known.")
    progress: ProgressView
    verdict: VerdictView | None
    log_tail: str = Field(
        description="The end of what the policy printed in episodes that it failed in; empty in a list."
    )
    played: PlayedScoreView | None = Field(
        default=None, description="Over the tasks of `counted_tasks` that were played; null where none was."
    )
    success_rate: float | None = Field(
        description="Mean over the tasks of `counted_tasks`; a task not played counts as 0."
    )
    success_rate_interval: tuple[float, float] | None = Field(description="Of that mean, 95 %.")
    mean_steps: float | None = Field(description="Mean of all tasks' mean steps; null where a task has none.")
    scores: list[TaskScoreView]
    practice_scores: list[PracticeScoreView] | None = Field(
        default=None, description="On the public list, where a sealed one ranks and both are played."
    )
    counted_tasks: list[str] = Field(
        description="Tasks of the track that are combined, as when it was scored; of a log the one that it plays."
    )
    evaluator_hash: str
    platform_class: str | None
    isolation: list[str] = Field(description="How the policy was isolated, on each kind of worker machine.")
    packages: list[PackagesView] = Field(
        default=[], description="What the policy could import, each list once; empty in a list of submissions."
    )
    list_kind: ListKind = Field(description="Who could know the episodes that it plays.")
    commitment: str | None = Field(description="Of the sealed list of its stage; null for a track file's own list.")
    episodes_hidden: bool = Field(description="Single episodes are not shown as long as the list is sealed.")
    differing_episodes: list[DifferingEpisodeView] | None = Field(
        description="For organizers: episodes that were played again with another record; null for a team."
    )


class EvaluationRowView(EvaluationSummaryView):
    """A line of the organizers' list of evaluations."""

    submission_id: UUID
    team: str
    track: str
    success_rate: float | None
    mean_steps: float | None
    verdict: VerdictView | None
    platform_class: str | None
    started_at: datetime | None
    differing_episodes: int = Field(description="How many episodes were played again with another record.")
    copied_episodes: int = Field(
        description="Of a log: how many episodes have the states of an earlier submission of another team."
    )


class RepeatView(View):
    """Why a shard was queued again, once."""

    at: datetime
    cause: RepeatCause
    reason: str


class ShardView(View):
    """A fixed part of an evaluation's episode list, and who works on it."""

    number: int
    task: str
    episodes: list[int]
    state: WorkState
    attempts: int
    worker_id: UUID | None
    packages_digest: str | None = Field(description="Of the packages that its policy saw; null where none ran.")
    repeats: list[RepeatView] = Field(description="Why it was queued again, each time.")


class EvaluationDetailView(EvaluationView):
    """One run of the evaluator as organizers see it."""

    submission_id: UUID
    team: str
    track: str
    shards: list[ShardView]
