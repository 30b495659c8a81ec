"""An upload that passed all checks; made by the checks of its kind, turned into a submission by `submissions`."""

from dataclasses import dataclass
from typing import Any

from vitac.evaluator.submission_kinds import SubmissionKind


@dataclass(frozen=True, kw_only=True)
class CheckedUpload:
    """An upload that passed all checks and is stored."""

    kind: SubmissionKind
    track: str
    tasks: tuple[str, ...]
    name: str
    digest: str
    archive_sha256: str
    archive_bytes: int
    manifest: dict[str, Any]
