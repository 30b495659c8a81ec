"""Teams, their limits and tokens, and the audit log."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import BigInteger, CheckConstraint, ForeignKey, Identity, String, func
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship
from vitac.server.db.states import Quota, Role

from .base import Base, closed_set


class Team(Base):
    """Who submits; the unit of privacy and of limits. `name_key` is the name without case and spacing.

    A disqualified team is on no board and submits nothing; `disqualified_for` says why.
    """

    __tablename__ = "teams"
    __table_args__ = (
        CheckConstraint("(disqualified_at IS NULL) = (disqualified_for IS NULL)", name="disqualified_for_a_reason"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64), unique=True)
    contact: Mapped[str | None] = mapped_column(String(254))
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    disqualified_at: Mapped[datetime | None]
    disqualified_for: Mapped[str | None]


class TeamQuota(Base):
    """A limit of a team's own, in place of the settings'. `most` is NULL where any number is possible."""

    __tablename__ = "team_quotas"
    __table_args__ = (CheckConstraint("most >= 0", name="is_a_number"),)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    quota: Mapped[Quota] = mapped_column(closed_set(Quota, "quota", length=32), primary_key=True)
    most: Mapped[int | None]


class ApiToken(Base):
    """A secret by which a client proves who it is; only its SHA-256 is kept."""

    __tablename__ = "api_tokens"
    __table_args__ = (
        CheckConstraint("(role = 'team') = (team_id IS NOT NULL)", name="team_tokens_have_a_team"),
        CheckConstraint("length(secret_sha256) = 64", name="secret_is_hashed"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    role: Mapped[Role] = mapped_column(closed_set(Role, "role"))
    team_id: Mapped[UUID | None] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    label: Mapped[str] = mapped_column(String(64))
    secret_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]
    team: Mapped[Team | None] = relationship()


class AuditEntry(Base):
    """Who changed what, with what it was before; rows are only ever added (triggers refuse the rest).

    `before` is NULL where the action makes something new or starts or ends something.
    """

    __tablename__ = "audit_log"
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    at: Mapped[datetime] = mapped_column(server_default=func.now(), index=True)
    actor: Mapped[str]
    action: Mapped[str]
    subject: Mapped[str]
    before: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True))
    after: Mapped[dict[str, Any]]
