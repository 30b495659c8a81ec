"""Rows about members: their sessions, questions, announcements, and the notices sent to them."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, UniqueConstraint, func, text
from sqlalchemy.orm import Mapped, mapped_column, relationship, synonym

from ..states import AppealState, NoticeChannel, NoticeKind, WorkKind
from .accounts import Team
from .base import Base, closed_set, sha256_check
from .evaluations import Evaluation, Work


class Announcement(Base):
    """What organizers say to everybody, or in a message to one team.

    With an empty `competition` it is of the whole service.
    """

    __tablename__ = "announcements"
    id: Mapped[int] = mapped_column(primary_key=True)
    competition: Mapped[str] = mapped_column(default="", server_default="")
    team_id: Mapped[UUID | None] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    title: Mapped[str] = mapped_column(String(120))
    text: Mapped[str]
    published_at: Mapped[datetime] = mapped_column(server_default=func.now())
    withdrawn_at: Mapped[datetime | None]
    team: Mapped[Team | None] = relationship()


class Question(Base):
    """A question of a team to the organizers; a `public` one is everybody's once it is answered."""

    __tablename__ = "questions"
    __table_args__ = (CheckConstraint("(answer IS NULL) = (answered_at IS NULL)", name="answer_has_a_time"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[UUID | None] = mapped_column(ForeignKey("teams.id", ondelete="SET NULL"), index=True)
    text: Mapped[str]
    public: Mapped[bool]
    asked_at: Mapped[datetime] = mapped_column(server_default=func.now())
    answer: Mapped[str | None]
    answered_at: Mapped[datetime | None]
    hidden_at: Mapped[datetime | None]
    team: Mapped[Team | None] = relationship()


class Appeal(Base):
    """A team says that an evaluation, or one episode of it, went wrong. An organizer rules on it."""

    __tablename__ = "appeals"
    __table_args__ = (
        CheckConstraint("(task IS NULL) = (episode IS NULL)", name="episodes_have_a_task"),
        CheckConstraint("(state = 'open') = (ended_at IS NULL)", name="ended_has_a_time"),
        CheckConstraint("(state IN ('upheld', 'rejected')) = (ruling IS NOT NULL)", name="ruled_on_has_a_ruling"),
        Index("uq_appeals_open", "evaluation_id", unique=True, postgresql_where=text("state = 'open'")),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="CASCADE"))
    task: Mapped[str | None]
    episode: Mapped[int | None]
    text: Mapped[str]
    state: Mapped[AppealState] = mapped_column(closed_set(AppealState, "state"))
    opened_at: Mapped[datetime] = mapped_column(server_default=func.now())
    ended_at: Mapped[datetime | None]
    ruling: Mapped[str | None]
    team: Mapped[Team] = relationship()
    evaluation: Mapped[Evaluation] = relationship()
    replays: Mapped[list["AppealReplay"]] = relationship(back_populates="appeal", order_by="AppealReplay.id")


class AppealReplay(Work):
    """An episode that an organizer has played again for an appeal, and what it gave beside the stored result.

    `corrected` is one that is played with another policy than the submission's, `policy_sha256` its archive. Without
    an `outcome` it is not played yet; `failure` is why the policy failed in it.
    """

    __tablename__ = "appeal_replays"
    __table_args__ = (sha256_check("policy_sha256"),)
    id: Mapped[int] = mapped_column(ForeignKey("work.id", ondelete="CASCADE"), primary_key=True)
    appeal_id: Mapped[int] = mapped_column(ForeignKey("appeals.id", ondelete="CASCADE"), index=True)
    task: Mapped[str]
    episode: Mapped[int]
    policy_sha256: Mapped[str] = mapped_column(String(64))
    corrected: Mapped[bool]
    outcome: Mapped[str | None]
    env_steps: Mapped[int | None]
    same_states: Mapped[bool | None]
    failure: Mapped[str | None]
    old_outcome: Mapped[str]
    old_env_steps: Mapped[int]
    appeal: Mapped[Appeal] = relationship(back_populates="replays")
    played_at: Mapped[datetime | None] = synonym("finished_at")
    __mapper_args__ = {"polymorphic_identity": WorkKind.REPLAY}  # noqa: RUF012 - SQLAlchemy reads it


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
