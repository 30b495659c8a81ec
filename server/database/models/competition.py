"""Rows of competitions: their stages, judges' marks, and results that are entered by hand."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import CheckConstraint, Float, ForeignKey, LargeBinary, String, UniqueConstraint, func, text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship

from .accounts import Team
from .base import Base, sha256_check


class CompetitionRow(Base):
    """A competition of this service.

    Attributes:
        name: of its file; rows that belong to it say so by this name in `competition`.
        definition: what `server.competition.definition` reads.
        frozen_at: from then on boards show no new results to anybody but organizers; NULL: they do. May lie ahead.
        finalized_at: since then winners and boards change only by `finalize_again`, and where a team is erased.
        winners: as they were finalized, or finalized again.
        reopened: each reopening after the end, with its reason.
        boards: as they were then (`LeaderboardView`); NULL before, and of one that was final before they were stored.
    """

    __tablename__ = "competition"
    __table_args__ = (
        CheckConstraint("name <> ''", name="has_a_name"),
        CheckConstraint("(finalized_at IS NULL) = (winners IS NULL)", name="final_has_winners"),
        CheckConstraint("boards IS NULL OR finalized_at IS NOT NULL", name="only_final_has_boards"),
    )
    name: Mapped[str] = mapped_column(primary_key=True)
    definition: Mapped[dict[str, Any]]
    applied_at: Mapped[datetime] = mapped_column(server_default=func.now())
    frozen_at: Mapped[datetime | None]
    finalized_at: Mapped[datetime | None]
    winners: Mapped[list[dict[str, Any]] | None] = mapped_column(JSONB(none_as_null=True))
    boards: Mapped[list[dict[str, Any]] | None] = mapped_column(JSONB(none_as_null=True))
    reopened: Mapped[list[dict[str, str]]] = mapped_column(JSONB, default=list, server_default="[]")


class SealedList(Base):
    """The secret from which the episode lists of a stage follow; everybody may know it once it is revealed.

    One that is withdrawn is played by no stage now; where its stage is sealed again, it is the same list again.
    `played_at` says of a final list since when the chosen submissions play it.
    """

    __tablename__ = "sealed_lists"
    __table_args__ = (
        UniqueConstraint("competition", "track", "stage"),
        sha256_check("commitment"),
        CheckConstraint("secret ~ '^[0-9a-f]{64}$'", name="secret_is_hexadecimal"),
    )
    commitment: Mapped[str] = mapped_column(String(64), primary_key=True)
    competition: Mapped[str]
    track: Mapped[str]
    stage: Mapped[str]
    secret: Mapped[str] = mapped_column(String(64))
    made_at: Mapped[datetime] = mapped_column(server_default=func.now())
    revealed_at: Mapped[datetime | None]
    withdrawn_at: Mapped[datetime | None]
    played_at: Mapped[datetime | None]


class Rejudgement(Base):
    """Submissions that are evaluated again beside their present results, until this is applied or discarded.

    Attributes:
        competition: name of the competition; empty outside of one.
        stage: of the competition; empty outside of one.
        reason: why, as the organizer says it.
    """

    __tablename__ = "rejudgements"
    __table_args__ = (CheckConstraint("applied_at IS NULL OR discarded_at IS NULL", name="ends_in_one_way"),)
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    competition: Mapped[str] = mapped_column(default="", server_default="")
    track: Mapped[str]
    stage: Mapped[str]
    reason: Mapped[str]
    started_at: Mapped[datetime] = mapped_column(server_default=func.now())
    applied_at: Mapped[datetime | None]
    discarded_at: Mapped[datetime | None]


class Qualification(Base):
    """A team that may take part in a stage for qualified teams."""

    __tablename__ = "qualifications"
    competition: Mapped[str] = mapped_column(primary_key=True)
    track: Mapped[str] = mapped_column(primary_key=True)
    stage: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    confirmed_at: Mapped[datetime] = mapped_column(server_default=func.now())


class Brief(Base):
    """A team's document for a stage, and what the committee decided of it; NULL: nothing yet."""

    __tablename__ = "briefs"
    __table_args__ = (
        sha256_check("sha256"),
        CheckConstraint("(accepted IS NULL) = (decided_at IS NULL)", name="decision_has_a_time"),
    )
    competition: Mapped[str] = mapped_column(primary_key=True)
    track: Mapped[str] = mapped_column(primary_key=True)
    stage: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    content: Mapped[bytes] = mapped_column(LargeBinary, deferred=True)
    sha256: Mapped[str]
    pages: Mapped[int]
    received_at: Mapped[datetime] = mapped_column(server_default=func.now())
    accepted: Mapped[bool | None]
    reason: Mapped[str] = mapped_column(default="", server_default=text("''"))
    decided_by: Mapped[str | None]
    decided_at: Mapped[datetime | None]
    team: Mapped[Team] = relationship()


class EnteredResult(Base):
    """The points of an attempt, as an operator has entered them; without a team it is a baseline of that name."""

    __tablename__ = "entered_results"
    __table_args__ = (
        UniqueConstraint(
            "competition", "track", "stage", "team_id", "baseline", "attempt", postgresql_nulls_not_distinct=True
        ),
        CheckConstraint("(team_id IS NULL) <> (baseline IS NULL)", name="is_of_a_team_or_a_baseline"),
        CheckConstraint("attempt >= 1", name="attempt_is_counted_from_1"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    competition: Mapped[str]
    track: Mapped[str]
    stage: Mapped[str]
    team_id: Mapped[UUID | None] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"))
    baseline: Mapped[str | None]
    attempt: Mapped[int]
    points: Mapped[dict[str, Any]] = mapped_column(JSONB)
    evidence: Mapped[str]
    entered_by: Mapped[str]
    entered_at: Mapped[datetime] = mapped_column(server_default=func.now())
    team: Mapped[Team | None] = relationship()


class HumanBaseline(Base):
    """Episodes of a task that people played by marker flow alone, each `[shape, solved, env steps, measures]`."""

    __tablename__ = "human_baselines"
    track: Mapped[str] = mapped_column(primary_key=True)
    task: Mapped[str] = mapped_column(primary_key=True)
    episodes: Mapped[list[tuple[str, bool, int, dict[str, float]]]] = mapped_column(JSONB)
    published_by: Mapped[str]
    published_at: Mapped[datetime] = mapped_column(server_default=func.now())


class JudgingMark(Base):
    """A judge's mark of a submission for one criterion of its track's rubric."""

    __tablename__ = "judging_marks"
    __table_args__ = (CheckConstraint("mark >= 0 AND mark <= 10", name="mark_is_in_range"),)
    submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True)
    judge: Mapped[str] = mapped_column(primary_key=True)
    criterion: Mapped[str] = mapped_column(primary_key=True)
    mark: Mapped[float] = mapped_column(Float)
    given_at: Mapped[datetime] = mapped_column(server_default=func.now())


class JudgingConflict(Base):
    """A judge who does not judge a team."""

    __tablename__ = "judging_conflicts"
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    judge: Mapped[str] = mapped_column(primary_key=True)
    reason: Mapped[str]
    declared_at: Mapped[datetime] = mapped_column(server_default=func.now())
