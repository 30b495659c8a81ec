"""Compares the archives of models that act alike, for organizers."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import UUID

from sqlalchemy import select
from vitac.evaluator.submission.likeness import ArchiveSketch, compare_sketches, make_sketch
from vitac.evaluator.submission_kinds import SubmissionKind

from ..db.models import Submission
from ..principals import Principal
from ..services import Services
from ..views.evaluations import NearCopyView


def compare_archives(services: Services, by: Principal, found: Sequence[NearCopyView]) -> list[NearCopyView]:
    """Return near copies with how alike the archives are, where both are models and still stored.

    Raises:
        ServiceError: not an organizer, or an archive cannot be read.
    """
    by.require_organizer(by.contest)
    asked = {id_ for one in found for id_ in (one.submission_id, one.earlier_submission_id)}
    with services.database.reading() as session:
        is_model = Submission.id.in_(asked), Submission.kind == SubmissionKind.MODEL
        rows = session.execute(select(Submission.id, Submission.archive_sha256).where(*is_model))
        digests = {row.id: row.archive_sha256 for row in rows}

    @cache
    def sketch(submission: UUID) -> ArchiveSketch | None:
        digest = digests.get(submission)
        if digest is None or not services.blobs.holds(digest):
            return None
        with TemporaryDirectory(dir=services.settings.scratch_dir) as folder:
            path = Path(folder) / "archive.zip"
            services.blobs.fetch(digest, path)
            return make_sketch(path)

    return [_compared(one, sketch(one.earlier_submission_id), sketch(one.submission_id)) for one in found]


def _compared(found: NearCopyView, earlier: ArchiveSketch | None, later: ArchiveSketch | None) -> NearCopyView:
    if earlier is None or later is None:
        return found
    alike = compare_sketches(earlier, later)
    return found.model_copy(update={"code": alike.code, "weights": alike.weights})
