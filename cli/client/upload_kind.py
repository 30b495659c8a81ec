"""What a file to submit is, by its name, and how its upload is announced.

Called by `submit`.
"""

from __future__ import annotations

from pathlib import Path

from vitac.evaluator.submission_kinds import GZIP_TYPE, SubmissionKind

GZIP_MAGIC = b"\x1f\x8b"


def kind_of(path: Path) -> SubmissionKind:
    """Return what a file or folder is; the service checks it anyway."""
    if path.is_dir():
        return SubmissionKind.MODEL
    named = path.with_suffix("") if path.suffix == ".gz" else path
    suffix = named.suffix.lower()
    return next((kind for kind in SubmissionKind if suffix in kind.form.suffixes), SubmissionKind.MODEL)


def content_type(path: Path, kind: SubmissionKind) -> str:
    """Return how the body of an upload is announced."""
    types = kind.form.content_types
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
    return GZIP_TYPE if packed and GZIP_TYPE in types else types[0]
