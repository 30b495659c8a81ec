"""Rows of the service itself: its public log, receipts and playbacks, and what its processes leave."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Float,
    ForeignKey,
    Index,
    LargeBinary,
    SmallInteger,
    String,
    Text,
    false,
    func,
    text,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB
from sqlalchemy.orm import Mapped, mapped_column, relationship

from ...settings import OutdatedRule
from ..states import WorkerOrder, WorkerState, WorkKind
from .base import Base, closed_set, sha256_check
from .evaluations import EpisodeResult, Work


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


class ReceiptKey(Base):
    """The one key of this service (Ed25519, hexadecimal digits). It stays with the database, also in a backup."""

    __tablename__ = "receipt_key"
    __table_args__ = (
        CheckConstraint("id = 1", name="is_the_only_one"),
        CheckConstraint("private_key ~ '^[0-9a-f]{64}$'", name="private_key_is_hexadecimal"),
    )
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False, default=1, server_default=text("1"))
    private_key: Mapped[str] = mapped_column(String(64))
    public_key: Mapped[str] = mapped_column(String(64))
    made_at: Mapped[datetime] = mapped_column(server_default=func.now())


class ReceiptRow(Base):
    """A receipt and its entry of the log; triggers refuse to change one, to take one away and to leave a gap.

    Attributes:
        stands_for: `EntryKind`.
        entry: the bytes of the entry, as everybody reads them.
        leaf_hash: of these bytes, in the tree.
        content: what the receipt says, as JSON text.
        submission_id: of the submission that arrived; NULL otherwise.
        evaluation_id: of the evaluation whose result it is; NULL otherwise.
        board: on which the result may be.
    """

    __tablename__ = "receipts"
    __table_args__ = (
        CheckConstraint("number >= 1", name="counts_from_one"),
        CheckConstraint("(stands_for = 'submission') = (submission_id IS NOT NULL)", name="arrival_has_submission"),
        CheckConstraint("(stands_for = 'result') = (evaluation_id IS NOT NULL)", name="result_has_evaluation"),
        CheckConstraint("octet_length(leaf_hash) = 32", name="leaf_hash_is_sha256"),
    )
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    submission_id: Mapped[UUID | None] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"), unique=True)
    evaluation_id: Mapped[UUID | None] = mapped_column(ForeignKey("evaluations.id", ondelete="RESTRICT"), unique=True)
    stands_for: Mapped[str]
    content: Mapped[str]
    board: Mapped[str] = mapped_column(index=True)
    entry: Mapped[str]
    leaf_hash: Mapped[bytes] = mapped_column(LargeBinary)


class TreeNode(Base):
    """The hash over a complete tile of the log's tree, in a tile of the level above (`server.transparency.merkle`)."""

    __tablename__ = "tree_nodes"
    level: Mapped[int] = mapped_column(SmallInteger, primary_key=True, autoincrement=False)
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    hash: Mapped[bytes] = mapped_column(LargeBinary)


class Cosignature(Base):
    """What a witness signed of a checkpoint.

    Attributes:
        witness: its verifier key.
        size: of the checkpoint.
        signature: time and Ed25519 signature, as in a line of a note.
        signed_at: as the witness says.
    """

    __tablename__ = "cosignatures"
    witness: Mapped[str] = mapped_column(primary_key=True)
    size: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    signature: Mapped[bytes] = mapped_column(LargeBinary)
    signed_at: Mapped[datetime]


class Playback(Work):
    """The playback of an episode, by a key over all that it is made from: equal episodes share one.

    Its `owner` is whose limits count it.
    """

    __tablename__ = "playbacks"
    __table_args__ = (
        sha256_check("key"),
        sha256_check("scene_sha256"),
        sha256_check("cameras_sha256"),
        sha256_check("still_sha256"),
        sha256_check("film_sha256"),
        CheckConstraint("env_steps_played >= 0", name="counts_from_zero"),
        Index("ix_playbacks_asked_at", "asked_at"),
    )
    id: Mapped[int] = mapped_column(ForeignKey("work.id", ondelete="CASCADE"), primary_key=True)
    key: Mapped[str] = mapped_column(String(64), unique=True)
    episode_id: Mapped[int] = mapped_column(ForeignKey("episode_results.id", ondelete="CASCADE"), index=True)
    evaluator_version: Mapped[str]
    asked_at: Mapped[datetime] = mapped_column(server_default=func.now())
    env_steps_played: Mapped[int] = mapped_column(default=0)
    scene_sha256: Mapped[str | None] = mapped_column(String(64))
    cameras_sha256: Mapped[str | None] = mapped_column(String(64))
    still_sha256: Mapped[str | None] = mapped_column(String(64))
    film_sha256: Mapped[str | None] = mapped_column(String(64))
    episode: Mapped[EpisodeResult] = relationship()
    __mapper_args__ = {"polymorphic_identity": WorkKind.PLAYBACK}  # noqa: RUF012 - SQLAlchemy reads it
