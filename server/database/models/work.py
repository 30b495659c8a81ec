"""The queue: one row for each piece of work, whatever its kind; tables of kinds say what is to be done."""

from datetime import datetime
from typing import Any
from uuid import UUID

from sqlalchemy import BigInteger, CheckConstraint, Identity, Index, SmallInteger, func, text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Mapped, mapped_column

from ...database.models.base import Base, closed_set
from ...database.states import WorkKind, WorkState

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
