"""Submissions and uploads that are not complete."""

from datetime import datetime
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import BigInteger, CheckConstraint, ColumnElement, ForeignKey, Index, String, false, func, text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.ext.hybrid import hybrid_property
from sqlalchemy.orm import Mapped, mapped_column, relationship
from vitac.evaluator.submission_kinds import Need, SubmissionKind

from ..states import FileRole
from .accounts import Team
from .base import Base, closed_set, sha256_check


class Submission(Base):
    """One upload. The same content from the same team for the same stage of a track is the same submission.

    `competition` and `stage` are empty outside a competition. `merged_from` is the team that made it, where its
    present team had the same content already. `is_public` says whether everybody may see its result.
    Results of a disqualified one and of one that its team has withdrawn are on no board (`is_off_boards`);
    `disqualified_for` says why. Of a deleted one (`erased_at`) only name, scores and records are left.
    `copy_cleared_for` says why one that was found to be a copy is ranked. `archive_sketch` is what a model's archive is
    compared by, `contents` says what is in it. `description` is what the team wrote about its result;
    `description_removed_for` says why others do not see it.
    `chosen_at` says since when its team wants it to play the final list of its stage; `final_of` is the one that was
    chosen, of the submission that plays that list.
    """

    __tablename__ = "submissions"
    __table_args__ = (
        Index(
            "uq_submissions_content",
            "team_id",
            "competition",
            "track",
            "stage",
            "kind",
            "digest",
            unique=True,
            postgresql_where=text("merged_from IS NULL"),
        ),
        sha256_check("digest"),
        sha256_check("archive_sha256"),
        CheckConstraint("archive_bytes > 0", name="archive_is_not_empty"),
        CheckConstraint("(disqualified_at IS NULL) = (disqualified_for IS NULL)", name="disqualified_for_a_reason"),
        CheckConstraint("erased_at IS NULL OR withdrawn_at IS NOT NULL", name="erased_is_withdrawn"),
        CheckConstraint("(copy_cleared_at IS NULL) = (copy_cleared_for IS NULL)", name="copy_cleared_for_a_reason"),
        Index("ix_submissions_submitted_at_id", text("submitted_at DESC"), text("id DESC")),
        Index("ix_submissions_of_team", "team_id", text("submitted_at DESC"), text("id DESC")),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="RESTRICT"))
    kind: Mapped[SubmissionKind] = mapped_column(closed_set(SubmissionKind, "kind"))
    competition: Mapped[str] = mapped_column(default="", server_default="")
    track: Mapped[str]
    stage: Mapped[str] = mapped_column(default="", server_default="")
    tasks: Mapped[list[str]]
    name: Mapped[str] = mapped_column(String(128))
    digest: Mapped[str] = mapped_column(String(64))
    archive_sha256: Mapped[str] = mapped_column(String(64))
    archive_bytes: Mapped[int] = mapped_column(BigInteger)
    manifest: Mapped[dict[str, Any]]
    submitted_at: Mapped[datetime] = mapped_column(server_default=func.now())
    merged_from: Mapped[UUID | None]
    is_public: Mapped[bool] = mapped_column(default=False, server_default=false())
    disqualified_at: Mapped[datetime | None]
    disqualified_for: Mapped[str | None]
    withdrawn_at: Mapped[datetime | None]
    erased_at: Mapped[datetime | None]
    copy_cleared_at: Mapped[datetime | None]
    copy_cleared_for: Mapped[str | None]
    archive_sketch: Mapped[bytes | None] = mapped_column(deferred=True)
    description: Mapped[dict[str, str] | None] = mapped_column(JSONB(none_as_null=True))
    description_removed_for: Mapped[str | None]
    contents: Mapped[dict[str, Any] | None] = mapped_column(JSONB(none_as_null=True))
    chosen_at: Mapped[datetime | None]
    final_of: Mapped[UUID | None] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"), unique=True)
    team: Mapped[Team] = relationship()

    @property
    def needs_gpu(self) -> bool:
        """Whether only workers with a GPU can play it."""
        return bool(self.manifest.get("needs") == Need.GPU)

    @hybrid_property
    def is_off_boards(self) -> bool:
        """Whether its results count nowhere: it is disqualified, or its team has withdrawn it."""
        return self.disqualified_at is not None or self.withdrawn_at is not None

    @is_off_boards.inplace.expression
    @classmethod
    def _is_off_boards_expression(cls) -> ColumnElement[bool]:
        return cls.disqualified_at.is_not(None) | cls.withdrawn_at.is_not(None)


class SubmissionFile(Base):
    """A stored file of a submission besides its upload: under `sha256` in the file store."""

    __tablename__ = "submission_files"
    __table_args__ = (sha256_check("sha256"), CheckConstraint("n_bytes > 0", name="is_not_empty"))
    submission_id: Mapped[UUID] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True)
    role: Mapped[FileRole] = mapped_column(closed_set(FileRole, "role"), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    n_bytes: Mapped[int] = mapped_column(BigInteger)
    name: Mapped[str] = mapped_column(String(128))
    facts: Mapped[dict[str, Any]]


class PartialUpload(Base):
    """A body that arrives in pieces, whose parts wait in the file store until all are there.

    A finished one names the submission that it became, for a client that did not get the answer. `completed_at` is when
    its last byte arrived, which decides to which stage it is in time.
    """

    __tablename__ = "partial_uploads"
    __table_args__ = (
        CheckConstraint("received_bytes >= 0 AND received_bytes <= total_bytes", name="received_is_a_part"),
        CheckConstraint("total_bytes > 0", name="is_not_empty"),
        sha256_check("sha256"),
    )
    id: Mapped[UUID] = mapped_column(primary_key=True, default=uuid4)
    team_id: Mapped[UUID] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"), index=True)
    kind: Mapped[SubmissionKind] = mapped_column(closed_set(SubmissionKind, "kind"))
    track: Mapped[str | None]
    competition: Mapped[str | None]
    again: Mapped[bool]
    file_name: Mapped[str | None]
    total_bytes: Mapped[int] = mapped_column(BigInteger)
    received_bytes: Mapped[int] = mapped_column(BigInteger, default=0)
    sha256: Mapped[str | None] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(server_default=func.now())
    completed_at: Mapped[datetime | None]
    expires_at: Mapped[datetime] = mapped_column(index=True)
    submission_id: Mapped[UUID | None] = mapped_column(ForeignKey("submissions.id", ondelete="CASCADE"))
    team: Mapped[Team] = relationship()


class UploadPart(Base):
    """One stored part of a partial upload: where in the body it begins, and under which key it waits."""

    __tablename__ = "upload_parts"
    __table_args__ = (CheckConstraint("n_bytes > 0", name="is_not_empty"),)
    upload_id: Mapped[UUID] = mapped_column(ForeignKey("partial_uploads.id", ondelete="CASCADE"), primary_key=True)
    first_byte: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    n_bytes: Mapped[int]
    key: Mapped[str]
