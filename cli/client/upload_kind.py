"""What a file to submit is, by its name.

Called by `submit`.
"""

from __future__ import annotations

from pathlib import Path

from vitac.evaluator.submission_kinds import SubmissionKind


def kind_of(path: Path) -> SubmissionKind:
    """Return what a file or folder is; the service checks it anyway."""
    if path.is_dir():
        return SubmissionKind.MODEL
    named = path.with_suffix("") if path.suffix == ".gz" else path
    suffix = named.suffix.lower()
    return next((kind for kind in SubmissionKind if suffix in kind.form.suffixes), SubmissionKind.MODEL)
