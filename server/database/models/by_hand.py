"""What people judge, enter and play by hand: briefs of teams, results of attempts, baselines of persons."""

from datetime import datetime
from typing import Any
from uuid import UUID

from sqlalchemy import CheckConstraint, ForeignKey, LargeBinary, UniqueConstraint, func, text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship

from .accounts import Team
from .base import Base, sha256_check


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
