"""Leaderboards of tracks and tasks, and the boards of logs."""

from datetime import datetime
from typing import Self
from uuid import UUID

from pydantic import Field
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.ranking import Ranking, RankingKey
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind

from .base import View
from .evaluations import CopyView
from .scores import INTERVAL, PlayedScoreView, TaskRateView, TaskScoreView


class BoardEntryView(View):
    """A row of any board: whose it is, and what it shows."""

    team: str
    evaluation_id: UUID
    submission_id: UUID
    submission_name: str
    submitted_at: datetime
    evaluator_version: str


class RankedEntryView(BoardEntryView):
    """A row of a board that ranks."""

    stale: bool = Field(description="Another evaluator version made it: it is not comparable.")
    episodes: int
    successes: int
    result_hash: str
    list_kind: ListKind = Field(description="Who could know the episodes that it was scored on.")


class LeaderboardEntryView(RankedEntryView):
    """Best entry of one team."""

    rank: int | None = Field(
        description="Null for a copy, where another evaluator version made it, and on a board of references."
    )
    rank_range: tuple[int, int] | None = Field(
        description="First and last rank that it could have by chance, as the 95 % intervals of all entries overlap; "
        "null on a board that compares something else before success rates."
    )
    copy_of: CopyView | None = Field(default=None, description="Null where it is alike to no earlier one.")
    kind: SubmissionKind
    evaluated_at: datetime
    success_rate: float = Field(description="Of the task; without one the mean over all tasks, one not played being 0.")
    success_rate_interval: tuple[float, float] = Field(description="95 % interval of that.")
    mean_steps: float | None = Field(
        description="Of the task, or the mean of all tasks' means; null where one is missing."
    )
    measures: dict[str, float] = Field(default={}, description="Means of what boards may rank by, by its name.")
    played: PlayedScoreView | None = Field(
        default=None, description="Over the tasks that it plays alone, of those that count on this leaderboard."
    )
    scores: list[TaskScoreView] = Field(description="Of the tasks that it plays and this leaderboard ranks.")


class BaselineView(View):
    """What one of our example submissions reaches on a public list, or people by hand; it has no rank."""

    name: str = Field(description="Its folder in `examples/`, or who played.")
    is_human: bool = Field(
        default=False, description="People played by marker flow alone, on starts drawn like those of the list."
    )
    episodes: int
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float] = Field(description=INTERVAL)
    mean_steps: float | None = Field(description="Of the successes; null without one.")
    measures: dict[str, float] = Field(default={}, description="Means of what boards may rank by, by its name.")
    scores: list[TaskRateView] = Field(description="In each task.")


class LeaderboardView(View):
    """Standings of one track, or of one of its tasks."""

    track: str
    title: str
    tasks: list[str] = Field(description="All tasks of the track.")
    task: str | None = Field(description="The task that is ranked; null: all together.")
    stage: str | None = Field(description="Of the competition; null outside of one.")
    frozen_at: datetime | None = Field(description="Results after this moment are not shown; null: all are.")
    final_since: datetime | None = Field(
        default=None, description="Since then the results of the competition are final; null: they are not."
    )
    list_kind: ListKind = Field(description="Who can know the episodes that submissions to it play.")
    list_sentence: str | None = Field(
        default=None,
        description="Which of the two sealed lists of its stage it shows, and when the final one is played; null where "
        "there are no two.",
    )
    is_practice: bool = Field(
        default=False, description="Everybody can know the episodes: gives no prizes and no advancement."
    )
    is_reference: bool = Field(
        default=False, description="Nobody is ranked: its results, of blind runs, are what others are compared with."
    )
    ranking: Ranking = Field(default=Ranking(), description="What entries are compared by, one key after the other.")
    ranking_rule: str = Field(description="The same in words.")
    evaluator_version: str = Field(description="Whose results are ranked; each entry names the one that made it.")
    unranked: str | None = Field(
        default=None,
        description="Why entries have no rank since the evaluator changed, what brings it back; null: all have one.",
    )
    revision: str = Field(description="Changes with the entries; the ETag of the answer.")
    generated_at: datetime = Field(description="When this revision was put together.")
    teams: int = Field(description="Number of all entries.")
    entries: list[LeaderboardEntryView]
    baselines: list[BaselineView] = Field(
        default=[],
        description="For comparison, where it ranks a public list: our examples, and people who played by hand.",
    )
    next_after: int | None = Field(
        default=None, description="Give this as `after` for the next page; null on the last one."
    )

    def cut(self, after: int, limit: int) -> Self:
        """Return a page of it."""
        more = after + limit if len(self.entries) > after + limit else None
        return self.model_copy(update={"entries": self.entries[after : after + limit], "next_after": more})


class LogEntryView(RankedEntryView):
    """Best verified log, or best play of a policy server, of one team for one task."""

    rank: int | None = Field(description="Null for a copy, and where another evaluator version made it.")
    verdict: VerificationResult | None = Field(description="Null for what a policy server played here.")
    copy_of: CopyView | None = Field(description="Null where it is alike to no earlier one.")
    success_rate: float
    success_rate_interval: tuple[float, float]
    mean_steps: float | None


class LogBoardView(View):
    """Verified logs of one task, or plays of policy servers, ranked among themselves."""

    kind: SubmissionKind
    label: str = Field(description="What its scores are worth.")
    task: str
    title: str
    unranked: str | None = Field(
        default=None,
        description="Why entries have no rank since the evaluator changed, what brings it back; null: all have one.",
    )
    entries: list[LogEntryView]


class TextLogEntryView(BoardEntryView):
    """A 2025 text log: what it claims, and what our physics makes of its actions. Not ranked."""

    task: str
    claimed_success_rate: float
    claimed_mean_steps: float | None
    success_rate: float
    mean_steps: float | None
    problems: int


class LogBoardsView(View):
    """All logs of a track, apart from the evaluated models."""

    track: str
    title: str
    stage: str | None = Field(description="Of the competition; null outside of one.")
    final_since: datetime | None = Field(
        default=None, description="Since then the results of the competition are final; null: they are not."
    )
    ranking_rule: str
    evaluator_version: str
    revision: str = Field(description="Changes with the entries; the ETag of the answer.")
    generated_at: datetime = Field(description="When this revision was put together.")
    boards: list[LogBoardView]
    text_logs: list[TextLogEntryView]
    next_after: int | None = Field(
        default=None, description="Give this as `after` for the next page of each board; null on the last one."
    )
    why_rates_differ: str = Field(description="Why the claimed and the re-simulated rates of text logs differ.")

    def cut(self, after: int, limit: int) -> Self:
        """Return a page of each of its boards."""
        most = max([len(self.text_logs), *(len(board.entries) for board in self.boards)])
        boards = [board.model_copy(update={"entries": board.entries[after : after + limit]}) for board in self.boards]
        changes = {"boards": boards, "text_logs": self.text_logs[after : after + limit]}
        return self.model_copy(update=changes | {"next_after": after + limit if most > after + limit else None})


class ShakeUpView(View):
    """What a submission has reached on the final list, beside what it had reached on the live one."""

    team: str
    submission_id: UUID = Field(description="The one that played the final list.")
    live_rate: float
    final_rate: float
    interval: tuple[float, float] = Field(description="95 % interval of the final rate minus the live one.")
    live_rank: int = Field(
        description="Its place among the submissions on the final board, by what they had reached on the live list."
    )
    final_rank: int


class DatedRankView(View):
    """A rank that a team had from a moment on."""

    at: datetime
    rank: int


class TeamRanksView(View):
    """The ranks of one of a board's first teams over time."""

    team: str
    submission_id: UUID = Field(description="Of its present entry.")
    ranks: list[DatedRankView] = Field(description="Each change of its rank, the oldest first.")


class PastResultView(View):
    """What one submission of a team has reached in one task."""

    task: str
    submission_id: UUID
    submission_name: str
    submitted_at: datetime
    success_rate: float
    ranked_by: RankingKey = Field(description="What the board of the task compares first.")
    value: float | None = Field(description="Of that; null where the result has none.")
