"""An unpacked copy of a submission that exists while a block runs. Called by the commands that run a policy here."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from .manifest import stage


@contextmanager
def staged(submission: Path) -> Iterator[Path]:
    """Return the folder of an unpacked copy of a submission, which is removed when the block is left.

    Args:
        submission: zip or folder.

    Raises:
        ArchiveRejected: a rule of archives is broken.
        NoSubmission: the path is no submission.
    """
    with TemporaryDirectory(prefix="vitac-submission-") as folder:
        Path(folder).chmod(0o755)  # Under root the sandbox has a user of its own, which must reach the submission.
        yield stage(submission, Path(folder) / "submission")
