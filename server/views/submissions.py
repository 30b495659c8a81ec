"""Submissions as they are shown, with their newest evaluation and their places, and their sensors."""

from datetime import datetime
from uuid import UUID

from pydantic import Field
from vitac.evaluator.episodes.records import ContactForces
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.scoring.comparison import SensingGain
from vitac.evaluator.submission_kinds import SubmissionKind

from .base import View
from .evaluations import CopyView, EvaluationSummaryView, EvaluationView
from .operations import WorkersView
from .receipts import LogView
from .teams import TeamView


class DescriptionView(View):
    """What a team writes about a public result; all empty where nothing is shown."""

    text: str = Field(default="", description="Plain text of several lines.")
    code: str = Field(default="", description="https address of the code.")
    paper: str = Field(default="", description="https address of the paper.")
    discussion: str = Field(default="", description="https address of a place to discuss it.")
    revision: str = Field(default="", description="Changes with it; empty before anything is written.")
    removed_for: str | None = Field(
        default=None, description="Why an organizer removed it, for its team and organizers; null: nobody did."
    )


class BlankAnswerView(View):
    """How a policy server answered a blank observation at the upload."""

    task: str
    answer_s: float
    low: float = Field(description="Smallest number of the action; what is beyond [-1, 1] is clipped.")
    high: float


class ArchiveContents(View):
    """What a model's archive holds, as it was when it was uploaded."""

    frameworks: list[str] = Field(description="Modules that its code imports to compute with.")
    code_bytes: int
    weights_bytes: int
    blank_answers: list[BlankAnswerView] = Field(default=[], description="Of a policy server, by task.")


class ModelCardView(View):
    """What a model is, from its manifest, its archive and its evaluation."""

    name: str
    track: str
    tasks: list[str]
    observation_keys: list[str] | None = Field(description="Keys of the observation that it reads; null: all.")
    control_modes: dict[str, str] = Field(description="By task, where it names one.")
    archive_bytes: int
    contents: ArchiveContents | None = Field(description="Null where it was uploaded before this was read.")
    policy_ms: float | None = Field(
        description="Mean time in the policy per env step; null before a result, and where episodes are not shown."
    )


class RankView(View):
    """Place on a leaderboard of the team's best entry there, when it is this submission."""

    rank: int
    of: int


class SubmissionView(View):
    """One upload and its newest evaluation."""

    id: UUID
    team: TeamView
    kind: SubmissionKind
    competition: str | None = Field(default=None, description="Name of its competition; null outside of one.")
    track: str
    stage: str | None = Field(description="Of the competition; null outside of one.")
    tasks: list[str]
    missing_tasks: list[str] = Field(description="Tasks of the track that a model does not play; each counts as 0.")
    name: str
    digest: str = Field(description="SHA-256 of the content; equal for a folder and its zip, a log and its gzip.")
    archive_sha256: str
    archive_bytes: int
    submitted_at: datetime
    public: bool = Field(description="Everybody may see its result, once its evaluation is complete.")
    chosen: bool | None = Field(
        default=None,
        description="Whether its team wants it to play the final list of its stage; null where none is played.",
    )
    final_of: UUID | None = Field(
        default=None, description="The submission that was chosen, where this one plays a final list; null elsewhere."
    )
    disqualified_for: str | None = Field(default=None, description="Why it is on no board; null: it may be.")
    withdrawn_at: datetime | None = Field(
        default=None, description="When its team took it off all boards; null: it did not."
    )
    deleted_at: datetime | None = Field(
        default=None, description="When its team deleted the upload; null: it is stored."
    )
    copy_of: CopyView | None = Field(default=None, description="Null where it is alike to no earlier one.")
    description: DescriptionView | None = Field(default=None, description="What its team wrote about it, where shown.")
    evaluation: EvaluationView
    evaluations: list[EvaluationSummaryView] = Field(
        description="All runs, newest first; of another team's, the newest."
    )
    workers: WorkersView
    unranked: str | None = Field(
        description="Why a scored submission has no rank, as a copy or since the evaluator changed; else null."
    )
    waits: str | None = Field(default=None, description="Why none of its episodes begins, although workers run.")
    rank: RankView | None = Field(description="On the leaderboard of all tasks together.")
    task_ranks: dict[str, RankView] = Field(description="On the leaderboards of single tasks.")
    log: LogView | None = Field(description="Null for a model.")

    @property
    def played_rank(self) -> RankView | None:
        """Its place by what was played: on the leaderboard of the only task, or else of all tasks together."""
        played = self.evaluation.played
        return self.task_ranks.get(played.tasks[0], self.rank) if played and len(played.tasks) == 1 else self.rank


class SubmissionListView(View):
    """A page of submissions, newest first."""

    items: list[SubmissionView]
    next_before: UUID | None = Field(description="Give this as `before` for the next page; null on the last one.")


class EpisodeView(View):
    """How one episode ended."""

    task: str
    episode: int
    shape: str
    initial_offset: tuple[float, ...] = Field(
        description="Where it started; repeats of a start have the same shape and offset."
    )
    outcome: str
    success: bool
    env_steps: int
    forces: ContactForces | None = Field(default=None, description="Contact forces, where they are recorded.")
    draws: dict[str, float] = Field(
        default={}, description="Quantities that were drawn for it, where the task has any."
    )


class EpisodeOutputView(View):
    """What a policy printed in one episode, and why it failed."""

    task: str
    episode: int
    outcome: str
    output: str = Field(description="The end of it.")
    failure: str | None = Field(
        default=None, description="Verdict, what was said and what to do, where the policy failed in it."
    )


class OutputView(View):
    """What a policy printed, by episode; episodes without output are left out, unless the policy failed in them."""

    items: list[EpisodeOutputView]
    next_after: int | None = Field(description="Give this as `after` for the next page; null on the last one.")


class DocumentView(View):
    """The design document, which is only handed out."""

    name: str
    n_bytes: int
    sha256: str


class SensorView(View):
    """The sensor of a submission, as it was made when it was uploaded."""

    digest: str = Field(description="SHA-256 of what is scored: mesh, camera and markers.")
    mesh_digest: str = Field(description="SHA-256 of nodes and tetrahedra; `vitac sensor mesh` gives the same.")
    nodes: int
    tetrahedra: int
    is_own_mesh: bool = Field(description="The team has brought the mesh (tet.msh).")
    thickness_mm: float
    volume_mm3: float
    volume_error: float = Field(description="Of the mesh against the STL, relative.")
    distance_mm: float = Field(description="Largest one between the surfaces of mesh and STL.")
    worst_quality: float
    markers: int
    document: DocumentView
    coefficients_sha256: str | None = Field(
        description="Of what the standard estimator has learned of it in the newest evaluation; null before."
    )
    gain: SensingGain | None = Field(description="Standard minus blind; null until both runs are complete.")
    figures: SensorFigures | None = Field(
        description="As far as the blind run has measured them (`starts` of 90); null before its first shard."
    )
