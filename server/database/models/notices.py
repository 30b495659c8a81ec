"""Notices to teams that wait to be sent, and the webhooks that they go to."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import CheckConstraint, ForeignKey, Index, UniqueConstraint, func, text
from sqlalchemy.orm import Mapped, mapped_column

from ..states import NoticeChannel, NoticeKind
from .base import Base, closed_set


class Webhook(Base):
    """Where a team's own program gets notices. The secret signs them, so it is stored in clear."""

    __tablename__ = "webhooks"
    __table_args__ = (CheckConstraint("length(secret) = 64", name="secret_is_long"),)
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    address: Mapped[str]
    secret: Mapped[str]
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())


class Notice(Base):
    """One notice to one address: a mail's, or the id of a webhook.

    `due_at` is when it is tried next; whoever tries moves it on first, so that nobody else does meanwhile.
    """

    __tablename__ = "notices"
    __table_args__ = (
        UniqueConstraint("kind", "subject", "channel", "target", name="uq_notices_once"),
        CheckConstraint("attempts >= 0", name="attempts_are_counted"),
        CheckConstraint("sent_at IS NULL OR given_up_at IS NULL", name="is_sent_or_given_up"),
        Index("ix_notices_due", "due_at", postgresql_where=text("sent_at IS NULL AND given_up_at IS NULL")),
        Index("ix_notices_of_team", "team_id", "created_at"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, server_default=text("gen_random_uuid()"))
    kind: Mapped[NoticeKind] = mapped_column(closed_set(NoticeKind, "kind"))
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"))
    subject: Mapped[str]
    channel: Mapped[NoticeChannel] = mapped_column(closed_set(NoticeChannel, "channel"))
    target: Mapped[str]
    facts: Mapped[dict[str, Any]]
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    due_at: Mapped[datetime] = mapped_column(server_default=func.now())
    attempts: Mapped[int] = mapped_column(default=0, server_default=text("0"))
    sent_at: Mapped[datetime | None]
    given_up_at: Mapped[datetime | None]
    problem: Mapped[str | None]
