"""Marks of judges and their conflicts of interest."""

from datetime import datetime
from uuid import UUID

from sqlalchemy import CheckConstraint, Float, ForeignKey, func
from sqlalchemy.orm import Mapped, mapped_column

from .base import Base


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
