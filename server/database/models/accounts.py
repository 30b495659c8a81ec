"""Teams, their members, limits and tokens, and the audit log."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    ForeignKey,
    Identity,
    Index,
    String,
    UniqueConstraint,
    false,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship

from ..states import MemberRole, Quota, Role
from .base import Base, closed_set

_RANDOM_NAME = text("('Team '::text || upper(substr(md5((gen_random_uuid())::text), 1, 10)))")
"""What nobody can foresee; as the database writes it, so that models and migrations can be compared."""


class Team(Base):
    """Who submits; the unit of privacy and of limits. `name_key` is the name without case and spacing.

    A disqualified team is on no board and submits nothing; `disqualified_for` says why. A team submits once an
    organizer has accepted it (`approved_at`); a refused one never does. `named_at` is when it was last shown under
    another name, and `pseudonym` the random name under which others see it until an anonymous competition is final. Of
    a team that was removed (`erased_at`) only its submissions' names and scores are left. Only organizers read `note`.
    """

    __tablename__ = "teams"
    __table_args__ = (
        CheckConstraint("(disqualified_at IS NULL) = (disqualified_for IS NULL)", name="disqualified_for_a_reason"),
        CheckConstraint("approved_at IS NULL OR refused_for IS NULL", name="is_accepted_or_refused"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64), unique=True)
    contact: Mapped[str | None] = mapped_column(String(254))
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    disqualified_at: Mapped[datetime | None]
    disqualified_for: Mapped[str | None]
    approved_at: Mapped[datetime | None]
    refused_for: Mapped[str | None]
    named_at: Mapped[datetime] = mapped_column(server_default=func.now())
    erased_at: Mapped[datetime | None]
    pseudonym: Mapped[str] = mapped_column(String(64), server_default=_RANDOM_NAME)
    note: Mapped[str] = mapped_column(default="", server_default="")


class Member(Base):
    """A person of a team. One who has left keeps the row, without address and password.

    `name_key` tells the members of a team apart. `password_hash` is NULL for who signs in with a token only. `muted`
    are kinds of notices that they do not want. An address gets notices once it is confirmed by the code sent to it.
    """

    __tablename__ = "members"
    __table_args__ = (
        UniqueConstraint("team_id", "name_key"),
        Index(
            "uq_members_captain", "team_id", unique=True, postgresql_where=text("role = 'captain' AND left_at IS NULL")
        ),
        CheckConstraint(
            "left_at IS NULL OR (password_hash IS NULL AND email IS NULL)", name="who_has_left_has_no_password"
        ),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"))
    role: Mapped[MemberRole] = mapped_column(closed_set(MemberRole, "role"))
    name: Mapped[str] = mapped_column(String(64))
    name_key: Mapped[str] = mapped_column(String(64))
    email: Mapped[str | None] = mapped_column(String(254))
    email_confirmed_at: Mapped[datetime | None]
    email_code_sha256: Mapped[str | None]
    password_hash: Mapped[str | None]
    muted: Mapped[list[str]] = mapped_column(default=list, server_default=text("'{}'"))
    joined_at: Mapped[datetime] = mapped_column(server_default=func.now())
    left_at: Mapped[datetime | None]
    team: Mapped[Team] = relationship()


class Invitation(Base):
    """A code with which one person joins a team; only its SHA-256 is stored.

    `leads` says that this is the captain of a team for which nobody can act yet.
    """

    __tablename__ = "invitations"
    __table_args__ = (
        CheckConstraint("length(code_sha256) = 64", name="code_is_hashed"),
        CheckConstraint("used_at IS NULL OR revoked_at IS NULL", name="is_used_or_revoked"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    code_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    expires_at: Mapped[datetime]
    used_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    leads: Mapped[bool] = mapped_column(default=False, server_default="false")
    team: Mapped[Team] = relationship()


class TeamQuota(Base):
    """A limit of a team's own, in place of the settings'. `most` is NULL where any number is possible."""

    __tablename__ = "team_quotas"
    __table_args__ = (CheckConstraint("most >= 0", name="is_a_number"),)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True)
    quota: Mapped[Quota] = mapped_column(closed_set(Quota, "quota", length=32), primary_key=True)
    most: Mapped[int | None]


class ApiToken(Base):
    """A secret by which a client proves who it is; only its SHA-256 is stored.

    One without a member is shared by the team. An organizer's token with a `competition` is for that one only. One that
    `is_session` stands for a browser that signed in with a password; nobody has its secret.
    """

    __tablename__ = "api_tokens"
    __table_args__ = (
        CheckConstraint("(role = 'team') = (team_id IS NOT NULL)", name="team_tokens_have_a_team"),
        CheckConstraint("length(secret_sha256) = 64", name="secret_is_hashed"),
        CheckConstraint("competition IS NULL OR role = 'organizer'", name="a_competition_has_organizers"),
        CheckConstraint("member_id IS NULL OR team_id IS NOT NULL", name="members_have_a_team"),
        CheckConstraint("NOT is_session OR member_id IS NOT NULL", name="sessions_have_a_member"),
        Index(
            "uq_api_tokens_of_member",
            "member_id",
            unique=True,
            postgresql_where=text("revoked_at IS NULL AND NOT is_session"),
        ),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    role: Mapped[Role] = mapped_column(closed_set(Role, "role"))
    competition: Mapped[str | None]
    team_id: Mapped[UUID | None] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    member_id: Mapped[UUID | None] = mapped_column(ForeignKey("members.id", ondelete="CASCADE"), index=True)
    is_session: Mapped[bool] = mapped_column(default=False, server_default=false())
    label: Mapped[str] = mapped_column(String(64))
    secret_sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]
    team: Mapped[Team | None] = relationship()
    member: Mapped[Member | None] = relationship()


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
