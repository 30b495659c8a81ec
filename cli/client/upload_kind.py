"""What a file to submit is, by its name.

Called by `submit`.
"""

from pathlib import Path

from vitac.evaluator.submission_kinds import SubmissionKind, kind_of_file


def find_kind(path: Path) -> SubmissionKind:
    """Return what a file or folder is; the service checks it anyway."""
    return SubmissionKind.MODEL if path.is_dir() else kind_of_file(path.name)
