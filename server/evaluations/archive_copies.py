"""Finds models whose archive is alike to an earlier one of another team; noted when an evaluation is complete.

What acts alike is not ranked (`near_copies`); common code or weights alone only inform organizers, who see
both.
"""

from collections.abc import Collection, Iterator

from sqlalchemy import ColumnElement, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, joinedload, undefer
from vitac.evaluator.submission.likeness import ArchiveLikeness, ArchiveSketch, compare_sketches

from ..database.models import ArchiveCopy, Submission
from ..principals import Principal
from ..views.evaluations import ArchiveCopyView, NearCopyView


def note_archive_copies(session: Session, submission: Submission) -> None:
    """Compare a model with those that other teams have submitted to its track, and note of which it may be a copy.

    A submission that is alike to what its team had before is nobody's copy.
    """
    later_than_ours = Submission.submitted_at > submission.submitted_at
    ours = list(_find_alike(session, submission, Submission.team_id == submission.team_id, ~later_than_ours))
    first = min([submission.submitted_at, *(own.submitted_at for own, _ in ours)])
    others = Submission.team_id != submission.team_id, Submission.submitted_at < first
    for earlier, likeness in _find_alike(session, submission, *others):
        figures = {"code": likeness.code, "weights": likeness.weights}
        session.execute(
            insert(ArchiveCopy)
            .values(submission_id=submission.id, earlier_submission_id=earlier.id, **figures)
            .on_conflict_do_update(constraint="pk_archive_copies", set_=figures)
        )


def list_archive_copies(session: Session, by: Principal, *, limit: int = 1000) -> list[ArchiveCopyView]:
    """Return what was found, the newest first.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    query = (
        select(ArchiveCopy)
        .join(Submission, Submission.id == ArchiveCopy.submission_id)
        .options(
            joinedload(ArchiveCopy.submission).joinedload(Submission.team),
            joinedload(ArchiveCopy.earlier_submission).joinedload(Submission.team),
        )
        .order_by(ArchiveCopy.found_at.desc(), ArchiveCopy.submission_id, ArchiveCopy.earlier_submission_id)
        .limit(limit)
    )
    if by.competition is not None:
        query = query.where(Submission.competition == by.competition)
    return [
        ArchiveCopyView(
            submission_id=found.submission_id,
            submission_name=found.submission.name,
            team=found.submission.team.name,
            earlier_submission_id=found.earlier_submission_id,
            earlier_submission_name=found.earlier_submission.name,
            earlier_team=found.earlier_submission.team.name,
            track=found.submission.track,
            code=found.code,
            weights=found.weights,
            found_at=found.found_at,
        )
        for found in session.scalars(query)
    ]


def compare_archives(session: Session, by: Principal, found: Collection[NearCopyView]) -> list[NearCopyView]:
    """Return near copies with how alike the archives are, where both are models.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    asked = {id_ for one in found for id_ in (one.submission_id, one.earlier_submission_id)}
    rows = session.execute(
        select(Submission.id, Submission.archive_sketch).where(
            Submission.id.in_(asked), Submission.archive_sketch.is_not(None)
        )
    )
    sketches = {row.id: ArchiveSketch.from_bytes(row.archive_sketch) for row in rows}
    return [_compared(one, sketches.get(one.earlier_submission_id), sketches.get(one.submission_id)) for one in found]


def _compared(found: NearCopyView, earlier: ArchiveSketch | None, later: ArchiveSketch | None) -> NearCopyView:
    if earlier is None or later is None:
        return found
    alike = compare_sketches(earlier, later)
    return found.model_copy(update={"code": alike.code, "weights": alike.weights})


def _find_alike(
    session: Session, submission: Submission, *conditions: ColumnElement[bool]
) -> Iterator[tuple[Submission, ArchiveLikeness]]:
    if submission.archive_sketch is None:
        return
    ours = ArchiveSketch.from_bytes(submission.archive_sketch)
    others = session.scalars(
        select(Submission)
        .where(
            Submission.track == submission.track,
            Submission.id != submission.id,
            Submission.archive_sketch.is_not(None),
            *conditions,
        )
        .options(undefer(Submission.archive_sketch))
        .execution_options(yield_per=200)
    )
    for other in others:
        assert other.archive_sketch is not None  # noqa: S101 - as the query says
        likeness = compare_sketches(ArchiveSketch.from_bytes(other.archive_sketch), ours)
        if likeness.is_copy:
            yield other, likeness
