"""Rows of evaluations: their shards, episodes and scores, and the queue of work."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Float,
    ForeignKey,
    Identity,
    Index,
    SmallInteger,
    String,
    Text,
    UniqueConstraint,
    false,
    func,
    text,
    true,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind

from ..states import EvaluationState, WorkKind, WorkState
from .base import Base, closed_set, sha256_check
from .competition import SealedList
from .submissions import Submission

_QUEUED = text("state = 'queued'")
_HAS_ONE_PLACE = text("state = 'running' AND kind = 'sensor_check'")
"""Of which kind only one piece of an owner runs at a time (`server.queue.kinds`), whoever claims."""
_SHARED = text("kind NOT IN ('shard', 'trial')")


class Work(Base):
    """A piece of work for a worker. `token` rises with each claim: it fences off others.

    Of what waits, the lowest `priority` comes first, then what was begun before, then the lowest `turn`
    (`server.queue.work.next_turn`). `owner` is who shares with others, `requires` what a worker must have
    (`server.queue.work.name_requirement`). `attempts` counts the claims since it last progressed. `repeats` holds why
    it was queued again, once for each time (`views.evaluations.RepeatView`); `problem` why it has failed, where its
    kind says so.
    """

    __tablename__ = "work"
    __table_args__: tuple[Any, ...] = (
        CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_a_lease"),
        CheckConstraint("(state = 'running') <= (worker_id IS NOT NULL)", name="running_has_a_worker"),
        CheckConstraint("attempts >= 0 AND token >= attempts", name="each_attempt_has_a_token"),
        CheckConstraint("problem IS NULL OR state = 'failed'", name="problem_is_a_failure"),
        CheckConstraint(
            "state <> 'failed' OR problem IS NOT NULL OR kind IN ('shard', 'trial')", name="failed_has_a_problem"
        ),
        Index("ix_work_queued", "priority", text("(token = 0)"), "turn", "id", postgresql_where=_QUEUED),
        Index("ix_work_open", "kind", "owner", postgresql_where=text("state IN ('queued', 'running')")),
        Index("ix_work_shared", "kind", "started_at", postgresql_where=_SHARED),
        Index("uq_work_place", "kind", "owner", unique=True, postgresql_where=_HAS_ONE_PLACE),
    )
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    kind: Mapped[WorkKind] = mapped_column(closed_set(WorkKind, "kind"))
    owner: Mapped[str]
    requires: Mapped[str]
    priority: Mapped[int] = mapped_column(SmallInteger)
    turn: Mapped[int] = mapped_column(default=0, server_default=text("0"))
    state: Mapped[WorkState] = mapped_column(
        closed_set(WorkState, "state"), default=WorkState.QUEUED, server_default=WorkState.QUEUED.value
    )
    token: Mapped[int] = mapped_column(BigInteger, default=0, server_default=text("0"))
    attempts: Mapped[int] = mapped_column(default=0, server_default=text("0"))
    worker_id: Mapped[UUID | None]
    not_before: Mapped[datetime] = mapped_column(server_default=func.now())
    queued_at: Mapped[datetime] = mapped_column(server_default=func.now())
    started_at: Mapped[datetime | None]
    progressed_at: Mapped[datetime | None]
    lease_expires_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    repeats: Mapped[list[dict[str, Any]]] = mapped_column(JSONB, default=list, server_default="[]")
    problem: Mapped[str | None]
    __mapper_args__ = {"polymorphic_on": "kind"}  # noqa: RUF012 - SQLAlchemy reads it


ALL_TASKS = "*"
"""Name of the board that ranks all tasks of a track together; those of single tasks have the tasks' names."""


_BOARD = ("competition", "track", "stage", "kind", "board")
_RANKING = ("sort_key", "evaluation_id")


class Evaluation(Base):
    """One run of the evaluator over a submission. Run 1 uses stored episodes; a higher run has records of its own.

    One that `is_proposed` belongs to a rejudgement that was not applied: it is no result of its submission.
    `commitment` names the sealed list whose result ranks; NULL: the public one. Beside a sealed list the public one is
    played too, whose scores are `practice_scores`; NULL: it was not. `fresh_commitment` names the fresh list that is
    played beside a sealed one that decides at once, `fresh_scores` are those on it. `turn` orders those that wait, see
    `server.queue.work`. `charged_at` says when the team's quotas counted it; NULL
    where it costs nothing. `asked_by_team`: organizers did not start it. `packages`: lists of the packages that the
    policy saw, versions by name, each list once (`Shard.packages_digest` names one); nothing of episodes stored before.
    `list_kind` says who could know the episodes when it began, `counted_tasks` which tasks were combined when it was
    scored; NULL before.
    """

    __tablename__ = "evaluations"
    __table_args__ = (
        CheckConstraint("run >= 1", name="run_counts_from_one"),
        CheckConstraint(
            "(state IN ('completed', 'failed', 'cancelled')) = (finished_at IS NOT NULL)", name="finished_has_a_time"
        ),
        CheckConstraint(
            "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL)",
            name="only_completed_has_a_score",
        ),
        CheckConstraint("(state = 'failed') = (verdict_code IS NOT NULL)", name="only_failed_has_a_verdict"),
        CheckConstraint("NOT is_proposed OR rejudgement_id IS NOT NULL", name="proposed_by_a_rejudgement"),
        sha256_check("result_hash"),
        sha256_check("evaluator_hash"),
        Index(
            "uq_evaluations_active",
            "submission_id",
            unique=True,
            postgresql_where=text("state IN ('queued', 'running')"),
        ),
        Index(
            "uq_evaluations_run",
            "submission_id",
            "evaluator_version",
            "run",
            unique=True,
            postgresql_where=text("state IN ('queued', 'running', 'completed')"),
        ),
        Index("ix_evaluations_state_created_at", "state", "created_at"),
        Index("ix_evaluations_completed_finished_at", "finished_at", postgresql_where=text("state = 'completed'")),
        Index("ix_evaluations_rejudgement_id", "rejudgement_id", postgresql_where=text("rejudgement_id IS NOT NULL")),
        Index("ix_evaluations_charged_at", "charged_at", postgresql_where=text("charged_at IS NOT NULL")),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"), index=True)
    run: Mapped[int]
    evaluator_version: Mapped[str]
    evaluator_hash: Mapped[str] = mapped_column(String(64))
    platform_class: Mapped[str | None]
    commitment: Mapped[str | None] = mapped_column(ForeignKey("sealed_lists.commitment", ondelete="RESTRICT"))
    state: Mapped[EvaluationState] = mapped_column(closed_set(EvaluationState, "state"))
    episodes_reused: Mapped[int] = mapped_column(default=0)
    rejudgement_id: Mapped[UUID | None] = mapped_column(ForeignKey("rejudgements.id", ondelete="RESTRICT"))
    is_proposed: Mapped[bool] = mapped_column(default=False, server_default=false())
    turn: Mapped[int] = mapped_column(default=0, server_default=text("0"))
    charged_at: Mapped[datetime | None]
    asked_by_team: Mapped[bool] = mapped_column(default=True, server_default=true())
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    verdict_code: Mapped[str | None]
    verdict_message: Mapped[str | None]
    verdict_task: Mapped[str | None]
    verdict_episode: Mapped[int | None]
    log_tail: Mapped[str] = mapped_column(default="")
    scores: Mapped[list[dict[str, Any]] | None] = mapped_column(JSONB(none_as_null=True))
    list_kind: Mapped[ListKind] = mapped_column(closed_set(ListKind, "list_kind"))
    counted_tasks: Mapped[list[str] | None] = mapped_column(ARRAY(Text))
    practice_scores: Mapped[list[dict[str, Any]] | None] = mapped_column(JSONB(none_as_null=True))
    fresh_commitment: Mapped[str | None] = mapped_column(String(64))
    fresh_scores: Mapped[list[dict[str, Any]] | None] = mapped_column(JSONB(none_as_null=True))
    result_hash: Mapped[str | None] = mapped_column(String(64))
    packages: Mapped[list[dict[str, str]]] = mapped_column(JSONB, default=list, server_default="[]", deferred=True)
    traceparent: Mapped[str | None] = mapped_column(deferred=True)
    submission: Mapped[Submission] = relationship()
    sealed_list: Mapped[SealedList | None] = relationship()
    shards: Mapped[list["Shard"]] = relationship(back_populates="evaluation", order_by="Shard.id")
    sensor_check: Mapped["SensorCheck | None"] = relationship(back_populates="evaluation")
    board_results: Mapped[list["BoardResult"]] = relationship(back_populates="evaluation")


class FreshList(Base):
    """The secret of a list that one evaluation plays, and nobody again: it is thrown away with the evaluation's end."""

    __tablename__ = "fresh_lists"
    __table_args__ = (sha256_check("commitment"),)
    commitment: Mapped[str] = mapped_column(String(64), primary_key=True)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), index=True)
    secret: Mapped[str] = mapped_column(String(64))


class BoardResult(Base):
    """What a completed evaluation is ranked by on one board: that of a task, or under `ALL_TASKS` that of the track.

    `ranked_by` has its values by name, `sort_key` those of the board's ranking, low first (`evaluator.ranking`).
    `is_copy` is one that is not ranked because another team had its states (`LogCopy`) or nearly its actions before
    (`NearCopy`), unless its submission was cleared; one that
    `is_off_boards`, with its submission, is on no board. The rest repeats what the rows of its evaluation, submission
    and team say, so that one index finds the best of each team.
    """

    __tablename__ = "board_results"
    __table_args__ = (
        Index("ix_board_results_of_version", *_BOARD, "evaluator_version", "team_id", *_RANKING),
        Index("ix_board_results_of_team", *_BOARD, "team_id", *_RANKING),
    )
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True)
    board: Mapped[str] = mapped_column(primary_key=True)
    competition: Mapped[str] = mapped_column(default="", server_default="")
    track: Mapped[str]
    stage: Mapped[str] = mapped_column(default="", server_default="")
    kind: Mapped[SubmissionKind] = mapped_column(closed_set(SubmissionKind, "kind"))
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="RESTRICT"))
    submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"))
    evaluator_version: Mapped[str]
    ranked_by: Mapped[dict[str, float | None]] = mapped_column(JSONB)
    sort_key: Mapped[list[float]] = mapped_column(ARRAY(Float))
    submitted_at: Mapped[datetime]
    finished_at: Mapped[datetime]
    is_copy: Mapped[bool] = mapped_column(default=False, server_default=false())
    is_off_boards: Mapped[bool] = mapped_column(default=False, server_default=false())
    evaluation: Mapped[Evaluation] = relationship(back_populates="board_results")


class BoardChange(Base):
    """A note that results, copies or teams have changed, made by triggers. `mark` is random."""

    __tablename__ = "board_changes"
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    mark: Mapped[int] = mapped_column(BigInteger)


class Shard(Work):
    """A fixed piece of an evaluation, the unit of its work and of resuming.

    `commitment` names the sealed list of which it plays a piece; empty for the public one. `packages_digest` is that
    of the packages that its policy saw (`evaluator.package_sets`); NULL where no policy ran. The list stands in the
    evaluation's `packages`. `finding` says why an uploaded log is not true (`evaluator.logs.findings.LogFinding`).
    """

    __tablename__ = "shards"
    __table_args__ = (
        UniqueConstraint("evaluation_id", "task", "number", "commitment"),
        CheckConstraint("cardinality(episodes) > 0", name="has_episodes"),
    )
    id: Mapped[int] = mapped_column(ForeignKey("work.id", ondelete="CASCADE"), primary_key=True)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"))
    task: Mapped[str]
    number: Mapped[int]
    commitment: Mapped[str] = mapped_column(default="", server_default="")
    episodes: Mapped[list[int]]
    manifest: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True))
    isolation: Mapped[str | None]
    packages_digest: Mapped[str | None] = mapped_column(String(64))
    finding: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True))
    code: Mapped[str | None] = mapped_column(String(16))
    evaluation: Mapped[Evaluation] = relationship(back_populates="shards")
    __mapper_args__ = {"polymorphic_identity": WorkKind.SHARD}  # noqa: RUF012 - SQLAlchemy reads it

    @property
    def title(self) -> str:
        """What it is, for messages."""
        return f"Episodes {self.episodes[0]} to {self.episodes[-1]} of {self.task}"


class Trial(Shard):
    """A shard that a station plays on its platform; `code` is what its present attempt shows to a camera."""

    __mapper_args__ = {"polymorphic_identity": WorkKind.TRIAL}  # noqa: RUF012 - SQLAlchemy reads it


class SensorCheck(Work):
    """Makes the sensor of a submission, before its evaluation gets its shards."""

    __tablename__ = "sensor_checks"
    id: Mapped[int] = mapped_column(ForeignKey("work.id", ondelete="CASCADE"), primary_key=True)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), unique=True)
    evaluation: Mapped[Evaluation] = relationship(back_populates="sensor_check")
    __mapper_args__ = {"polymorphic_identity": WorkKind.SENSOR_CHECK}  # noqa: RUF012 - SQLAlchemy reads it

    @property
    def title(self) -> str:
        """What it is, for messages."""
        return "The check of the sensor"


class EpisodeResult(Base):
    """One finished episode. The unique key makes every repeat of the same work write the same row.

    `output` is the end of what the policy printed (`accounts.visibility` says who may see it), no part of the record.
    `forces` are those of the record.
    """

    __tablename__ = "episode_results"
    __table_args__ = (
        UniqueConstraint(
            "submission_digest",
            "evaluator_version",
            "track",
            "task",
            "episode",
            "run",
            "commitment",
            name="uq_episode_results_key",
        ),
        CheckConstraint("success = (outcome = 'success')", name="success_is_the_outcome"),
        CheckConstraint("episode >= 1 AND run >= 1 AND env_steps >= 0", name="counts_from_one"),
        sha256_check("submission_digest"),
        sha256_check("record_digest"),
        Index("ix_episode_results_task_created_at", "task", text("created_at DESC")),
        Index("ix_episode_results_half_way_state", "half_way_state"),
    )
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    submission_digest: Mapped[str] = mapped_column(String(64))
    evaluator_version: Mapped[str]
    track: Mapped[str]
    task: Mapped[str]
    episode: Mapped[int]
    run: Mapped[int]
    commitment: Mapped[str] = mapped_column(default="", server_default="")
    shape: Mapped[str]
    initial_offset: Mapped[list[float]] = mapped_column(ARRAY(Float))
    outcome: Mapped[str]
    success: Mapped[bool]
    env_steps: Mapped[int]
    record: Mapped[dict[str, Any]]
    forces: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True))
    record_digest: Mapped[str] = mapped_column(String(64))
    states_digest: Mapped[str] = mapped_column(String(64))
    half_way_state: Mapped[str] = mapped_column(String(64))
    wall_s: Mapped[float] = mapped_column(Float)
    output: Mapped[str] = mapped_column(default="", server_default="", deferred=True)
    evaluation_id: Mapped[UUID | None] = mapped_column(ForeignKey("evaluations.id", ondelete="SET NULL"), index=True)
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())


class LogCopy(Base):
    """Number of episodes of a log with the states of an earlier submission of another team, the one with most of them.

    States count from half-way through an episode on (`EpisodeResult.half_way_state`).
    """

    __tablename__ = "log_copies"
    __table_args__ = (CheckConstraint("episodes > 0", name="some_are_equal"),)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True)
    earlier_submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"))
    episodes: Mapped[int]
    found_at: Mapped[datetime] = mapped_column(server_default=func.now())


class ActionTrace(Base):
    """First actions, and states on the way, of all episodes of a task on one list, by which near copies are found.

    `actions` and `paths` are float32, as `evaluator.scoring.near_copies` has them; `commitment` is empty for the public
    list.
    """

    __tablename__ = "action_traces"
    __table_args__ = (Index("ix_action_traces_task_commitment", "task", "commitment"),)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True)
    task: Mapped[str] = mapped_column(primary_key=True)
    commitment: Mapped[str] = mapped_column(primary_key=True, default="")
    action_size: Mapped[int]
    actions: Mapped[bytes]
    paths: Mapped[bytes] = mapped_column(default=b"", server_default="")


class NearCopy(Base):
    """An evaluation that acts nearly as an earlier submission of another team, on one list of a task.

    Attributes:
        near: of `episodes` those whose actions, commanded motions or states are within the tolerance.
        difference: median over the episodes of the largest difference of an action.
    """

    __tablename__ = "near_copies"
    __table_args__ = (CheckConstraint("near > 0 AND near <= episodes", name="some_are_near"),)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True)
    earlier_submission_id: Mapped[UUID] = mapped_column(
        ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True
    )
    task: Mapped[str] = mapped_column(primary_key=True)
    commitment: Mapped[str] = mapped_column(primary_key=True, default="")
    near: Mapped[int]
    episodes: Mapped[int]
    difference: Mapped[float] = mapped_column(Float)
    found_at: Mapped[datetime] = mapped_column(server_default=func.now())
    evaluation: Mapped[Evaluation] = relationship()
    earlier_submission: Mapped[Submission] = relationship()


class ArchiveCopy(Base):
    """A model whose archive is alike to that of an earlier model of another team in its track; it stays ranked.

    Attributes:
        code: share of the code of both that is in both; NULL without code.
        weights: correlation of the weights of both; NULL without weights that can be compared.
    """

    __tablename__ = "archive_copies"
    submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True)
    earlier_submission_id: Mapped[UUID] = mapped_column(
        ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True
    )
    code: Mapped[float | None] = mapped_column(Float)
    weights: Mapped[float | None] = mapped_column(Float)
    found_at: Mapped[datetime] = mapped_column(server_default=func.now())
    submission: Mapped[Submission] = relationship(foreign_keys=[submission_id])
    earlier_submission: Mapped[Submission] = relationship(foreign_keys=[earlier_submission_id])


class EpisodeDifference(Base):
    """An alarm: an episode was played again under this evaluation with another record than the stored one."""

    __tablename__ = "episode_differences"
    __table_args__ = (
        UniqueConstraint("evaluation_id", "task", "episode", "differing_digest", name="uq_episode_differences_key"),
        CheckConstraint("stored_digest <> differing_digest", name="records_differ"),
        sha256_check("stored_digest"),
        sha256_check("differing_digest"),
    )
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"))
    task: Mapped[str]
    episode: Mapped[int]
    stored_digest: Mapped[str] = mapped_column(String(64))
    differing_digest: Mapped[str] = mapped_column(String(64))
    worker_id: Mapped[UUID | None]
    seen_at: Mapped[datetime] = mapped_column(server_default=func.now())
