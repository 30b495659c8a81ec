"""Workers, the evaluator that the service declares, and what all processes have counted."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import BigInteger, Float, ForeignKey, Text, false, func
from sqlalchemy.dialects.postgresql import ARRAY, JSONB
from sqlalchemy.orm import Mapped, mapped_column

from ...settings import OutdatedRule
from ..states import WorkerOrder, WorkerState
from .base import Base, closed_set


class Worker(Base):
    """A worker process, its last heartbeat and the space on its disk at that time.

    `families` are those of whose tasks it can run shards, `has_gpu` whether it plays images that need a GPU.
    `sandbox` is what a policy finds in its sandbox (`evaluator.agent.description`); NULL where it refuses to run any.
    """

    __tablename__ = "workers"
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    host: Mapped[str]
    pid: Mapped[int]
    slots: Mapped[int]
    state: Mapped[WorkerState] = mapped_column(closed_set(WorkerState, "state"))
    evaluator_version: Mapped[str]
    families: Mapped[list[str]] = mapped_column(ARRAY(Text), server_default="{tactile}")
    has_gpu: Mapped[bool] = mapped_column(server_default=false())
    platform_class: Mapped[str]
    isolation: Mapped[str]
    worker_order: Mapped[WorkerOrder] = mapped_column(
        closed_set(WorkerOrder, "worker_order"), default=WorkerOrder.WORK, server_default=WorkerOrder.WORK.value
    )
    message: Mapped[str] = mapped_column(default="")
    started_at: Mapped[datetime] = mapped_column(server_default=func.now())
    heartbeat_at: Mapped[datetime] = mapped_column(server_default=func.now(), index=True)
    disk_bytes: Mapped[int | None] = mapped_column(BigInteger)
    disk_free_bytes: Mapped[int | None] = mapped_column(BigInteger)
    sandbox: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True), deferred=True)


class Station(Base):
    """A laboratory whose agent plays trials; `worker_id` is the agent that used its key last.

    `twin` is the kind of twin, in words, on which that agent plays; NULL for hardware.
    """

    __tablename__ = "stations"
    name: Mapped[str] = mapped_column(primary_key=True)
    key_sha256: Mapped[str] = mapped_column(unique=True)
    worker_id: Mapped[UUID | None]
    twin: Mapped[str | None]
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())


class LivePicture(Base):
    """What all cameras of a station saw in a trial of a stage, for visitors who watch later by the stage's delay."""

    __tablename__ = "live_pictures"
    station: Mapped[str] = mapped_column(ForeignKey("stations.name", ondelete="CASCADE"), primary_key=True)
    taken_at: Mapped[datetime] = mapped_column(primary_key=True, server_default=func.clock_timestamp())
    competition: Mapped[str]
    track: Mapped[str]
    stage: Mapped[str]
    picture: Mapped[bytes]


class DeclaredEvaluator(Base):
    """What the service evaluates with, as its server has said last: a version for each of its tracks.

    Under the empty name stands the version of our own sources, which most tracks have. `outdated` is the same in all.
    """

    __tablename__ = "declared_evaluators"
    track: Mapped[str] = mapped_column(primary_key=True)
    version: Mapped[str]
    outdated: Mapped[OutdatedRule] = mapped_column(
        closed_set(OutdatedRule, "outdated"), default=OutdatedRule.RESTART, server_default=OutdatedRule.RESTART.value
    )


class SchemaCompatibility(Base):
    """The oldest revision whose processes can work with the schema; one row."""

    __tablename__ = "schema_compatibility"
    oldest: Mapped[str] = mapped_column(primary_key=True)


class MetricTotal(Base):
    """Sum over all processes of one sample of `server.metrics.instruments`; `labels` is JSON with sorted keys."""

    __tablename__ = "metric_totals"
    name: Mapped[str] = mapped_column(primary_key=True)
    labels: Mapped[str] = mapped_column(primary_key=True)
    value: Mapped[float] = mapped_column(Float)
