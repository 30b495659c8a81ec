"""The competitions of a service: their definitions, the secrets of their sealed lists, and who may take part where."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import CheckConstraint, ForeignKey, String, UniqueConstraint, func
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column

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
