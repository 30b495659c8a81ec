"""Stored files of submissions besides their uploads: added with a submission, found, spared by housekeeping."""

from collections.abc import Iterable
from uuid import UUID

from sqlalchemy import Connection, delete, select, union
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..database.models import Submission, SubmissionFile, Team
from ..database.states import FileRole
from ..database.stored_uploads import WAS_CANCELLED
from ..uploads.checked_upload import UploadedFile


def add_files(session: Session, submission_id: UUID, files: Iterable[UploadedFile]) -> None:
    """Add the files of a submission; those that it has already stay, but for its sensor, of which it has one.

    Another mesher makes another sensor of the same archive: from then on that is the one that is played. New facts of a
    file are added to those that it has: two evaluations may learn the same of a sensor.
    """
    for file in files:
        if file.role is FileRole.SENSOR:
            is_sensor = (SubmissionFile.submission_id == submission_id, SubmissionFile.role == FileRole.SENSOR)
            session.execute(delete(SubmissionFile).where(*is_sensor, SubmissionFile.sha256 != file.sha256))
        added = insert(SubmissionFile).values(
            submission_id=submission_id,
            role=file.role,
            sha256=file.sha256,
            n_bytes=file.n_bytes,
            name=file.name,
            facts=file.facts,
        )
        session.execute(
            added.on_conflict_do_update(
                index_elements=["submission_id", "role", "sha256"],
                set_={"facts": SubmissionFile.facts.concat(added.excluded.facts)},
            )
        )


def find_file(session: Session, submission_id: UUID, role: FileRole) -> SubmissionFile | None:
    """Return a submission's file of a role, the last by digest where there are several; None without one."""
    return session.scalars(
        select(SubmissionFile)
        .where(SubmissionFile.submission_id == submission_id, SubmissionFile.role == role)
        .order_by(SubmissionFile.sha256.desc())
        .limit(1)
    ).first()


def stored_digests(connection: Connection | Session) -> list[str]:
    """Return the digests of all stored files that a submission has, sorted, each once.

    Not those of removed teams, and not those whose evaluations were all cancelled a day ago.
    """
    is_kept = Team.erased_at.is_(None) & ~WAS_CANCELLED
    uploads = select(Submission.archive_sha256).join(Submission.team).where(is_kept)
    others = (
        select(SubmissionFile.sha256)
        .join(Submission, Submission.id == SubmissionFile.submission_id)
        .join(Submission.team)
        .where(is_kept)
    )
    found = union(uploads, others).subquery()
    return sorted(connection.scalars(select(found.c[0])))
