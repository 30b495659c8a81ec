"""The competition as everybody sees it: schedule, rules, prizes, commitments, and at the end its winners."""

from datetime import datetime
from enum import StrEnum
from uuid import UUID

from pydantic import Field
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind

from ..database.states import WorkState
from .base import View
from .by_hand import EnteredTaskView
from .leaderboards import LeaderboardView
from .scores import RateView


class CompetitionState(StrEnum):
    """How far a competition is."""

    PLANNED = "planned"
    """No stage has opened."""
    OPEN = "open"
    """A stage takes submissions, or a later one will."""
    CLOSED = "closed"
    """All stages have closed, and the results are not final."""
    FINAL = "final"
    """Winners and boards are stored and do not change."""


class PlannedTrialView(View):
    """A trial of a stage that stations play by a plan."""

    position: int = Field(description="In the plan, from 1.")
    station: str
    twin: str | None = Field(
        description="What kind of twin the station was when it was played, or is until then, in words; null for "
        "hardware, and before the station's first agent."
    )
    team: str
    submission_id: UUID
    submission_name: str
    task: str
    episode: int
    state: WorkState


class TrialDifferenceView(View):
    """Two submissions compared in the blocks that are complete."""

    first: str
    second: str
    difference: float = Field(description="Success rate of the first minus that of the second.")
    interval: tuple[float, float] = Field(description="95 % interval of that, by start.")
    p_value: float = Field(description="Exact permutation test over the starts.")


class StationEffectView(RateView):
    """Trials at one station, whoever's they are; those from when it was a twin stand apart."""

    station: str
    twin: str | None = Field(description="What kind of twin the station was then, in words; null for hardware.")
    effect: float | None = Field(
        description="Success rate there minus that elsewhere, the mean over submissions; null for a single station."
    )
    effect_interval: tuple[float, float] | None = Field(description="95 % interval of that.")


class TrialResultsView(View):
    """What the plan of a stage shows once its trials are over."""

    blocks: int = Field(description="In which every submission has a result from the same start.")
    trials_left_out: int = Field(description="With a result, in other blocks.")
    differences: list[TrialDifferenceView]
    stations: list[StationEffectView]


class CompetitionSummaryView(View):
    """One of the competitions of a service."""

    name: str = Field(description="In addresses, `/competitions/NAME`, and where a submission says its competition.")
    title: str
    summary: str
    opens: datetime = Field(description="When its first stage opens.")
    closes: datetime = Field(description="When its last stage closes.")
    state: CompetitionState
    tracks: list[str] = Field(description="Names of the tracks whose submissions this service takes.")
    public_rankings: list[str] = Field(
        default_factory=list, description="What boards of public lists decide, a clause for each, as its pages say."
    )


class CompetitionListView(View):
    """The competitions of a service, the one that opened last first."""

    items: list[CompetitionSummaryView]


class StageView(View):
    """A stage of a track."""

    name: str
    title: str
    opens: datetime
    closes: datetime = Field(description="What is complete at this instant is too late.")
    final_of: str | None = Field(
        default=None, description="The stage of which it is the final list: nobody submits to it; null of a stage."
    )
    played_since: datetime | None = Field(
        default=None, description="Since when a final list is played; null before, and of a stage."
    )
    is_open: bool = Field(description="Whether it takes submissions now.")
    accepts: list[SubmissionKind]
    list_kind: ListKind | None = Field(description="Null where the service plays no episodes of it.")
    is_practice: bool = Field(
        default=False, description="Its list is public, and its boards give no prizes and no advancement."
    )
    commitment: str | None = Field(description="Of its sealed list.")
    secret: str | None = Field(description="Of its sealed list, once published; `vitac seeds verify` checks it.")
    scored_runs: int | None = Field(description="Most scored evaluations of a team; null: any number.")
    attempts: int | None = Field(description="Most evaluations of a team, however they end; null: any number.")
    qualified: str | None = Field(description="Who advances to it, in words; null: it is for all teams.")
    is_planned: bool = Field(default=False, description="Whether stations play it by a plan of trials.")
    answer_s: float | None = Field(
        default=None, description="Time that a policy server has for each answer [s]; null: as for any action."
    )
    brief: str | None = Field(default=None, description="What teams hand in for a committee, in words; null: nothing.")
    entered: list[EnteredTaskView] = Field(default=[], description="Tasks whose points operators enter.")


class PrizeView(View):
    """What a place wins."""

    place: str
    amount: int
    winners: int
    note: str | None


class CompetitionTrackView(View):
    """A track of the competition."""

    name: str
    title: str
    taken_here: bool = Field(description="False where submissions are collected elsewhere.")
    ranking: list[str] = Field(description="What entries are compared by, one after the other.")
    ties: str
    stages: list[StageView]
    prizes: list[PrizeView]
    picture: str | None = Field(
        default=None, description="Task whose picture stands for the track; null: its own first one."
    )
    judging: str | None = Field(default=None, description="How judges' marks count, in words; null: the board decides.")


class WinnerView(View):
    """A team and what it wins."""

    track: str
    place: str
    rank: int
    team: str
    amount: int
    won_by: str | None = Field(
        default=None, description="What the board compares first, with its value; null: operators entered the results."
    )
    success_rate: float | None = Field(default=None, description="Null: operators entered the results.")
    result_hash: str | None = None
    total: float | None = Field(
        default=None, description="Of success, marks and figures by the weights; null: the track is not judged."
    )
    points: float | None = Field(default=None, description="Of the attempt that won, where operators entered results.")
    evidence: str | None = Field(default=None, description="What shows that attempt.")


class DisqualifiedTeamView(View):
    """A team that was disqualified after the end, or whose entry was, by its name in stored winners and boards."""

    team: str
    disqualified_at: datetime


class ReopeningView(View):
    """An end that the organizers took back."""

    at: datetime
    reason: str


class WithdrawnListView(View):
    """A sealed list that no stage plays, because the competition's file was changed after its commitment was public."""

    track: str
    stage: str
    commitment: str
    made_at: datetime
    withdrawn_at: datetime


class CompetitionView(View):
    """The competition of this service."""

    name: str
    title: str
    summary: str
    website: str | None
    contact: str | None
    rules: list[str]
    currency: str
    teams_locked: datetime | None
    anonymous: bool = Field(
        default=False, description="Whether teams are shown under random names until everything is final."
    )
    appeal_days: int | None = Field(
        default=None,
        description="So long after the end of an evaluation its team may appeal; null: there are no appeals.",
    )
    tracks: list[CompetitionTrackView]
    public_rankings: list[str] = Field(
        default=[], description="What boards of public lists decide; empty where they are for practice only."
    )
    freeze_at: datetime | None = Field(default=None, description="When boards freeze by the file; null: not by it.")
    frozen_at: datetime | None = Field(description="Since then boards show no new results; null: they do.")
    finalized_at: datetime | None = Field(description="Since then everything is final.")
    winners: list[WinnerView] = Field(description="Empty before the end.")
    disqualified: list[DisqualifiedTeamView] = Field(
        default=[],
        description="Of winners and archived boards, since the end; without them once it is finalized again.",
    )
    reopened: list[ReopeningView] = Field(
        default=[], description="When the competition was reopened after its end, and why."
    )
    withdrawn_lists: list[WithdrawnListView] = Field(
        default=[], description="Commitments that were published, of lists that no stage plays now."
    )


class ProposedTeamView(View):
    """A team on the board of the stage before."""

    team: str
    rank: int
    success_rate: float
    interval: tuple[float, float] = Field(description="95 % interval of the success rate.")
    mean_steps: float | None
    advances: bool = Field(description="Whether the rule takes it.")
    at_border: bool = Field(
        description="Whether chance may have decided: its interval reaches across the border of the rule."
    )


class AdvancementView(View):
    """Who would advance by the rule, and who was confirmed."""

    track: str
    stage: str
    before: str = Field(description="Name of the stage whose board decides.")
    rule: str = Field(description="In words.")
    registered: int = Field(
        description="Teams that the rule counts: accepted, not disqualified, registered before the stage before closed."
    )
    teams: list[ProposedTeamView]
    unranked: list[str] = Field(
        description="Teams whose only results are of another evaluator version: evaluate them again first."
    )
    running: int = Field(description="Evaluations of the stage before that have not ended.")
    confirmed: list[str] = Field(description="Teams that take part, as confirmed last.")
    revision: str = Field(description="Of the confirmed teams; a confirmation names it. Empty if there are none.")


class ArchiveView(View):
    """What was final at the end of a competition."""

    competition: CompetitionView
    boards: list[LeaderboardView] = Field(description="Boards of every stage, as of the end or `find_last_decision`.")
    public_key: str = Field(description="Key that signed the receipts of the results.")
    decided_again_at: datetime | None = Field(
        default=None, description="When it was last decided without teams that were disqualified then; null: never."
    )
    citation: str = Field(description="How to cite the results, for BibTeX.")
