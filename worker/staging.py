"""Submissions on the worker's disk: fetched, checked and unpacked once while several shards of them run."""

import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.archive import unpack
from vitac.server.storage.blobs import BlobStore

KEPT_IDLE = 2
"""Unpacked submissions that are kept although no shard of them runs: the next shard is often of the same one."""
_PREFIX = "worker"


@dataclass(kw_only=True)
class _Staged:
    """One submission on disk; `ready` is set once it is unpacked, `users` counts running shards."""

    folder: Path
    submission_dir: Path | None = None
    users: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


class SubmissionStage:
    """Unpacked submissions below a folder of this process. Thread-safe; closed at the end of the worker."""

    def __init__(self, blobs: BlobStore, scratch_dir: Path, limits: Limits) -> None:
        self._blobs = blobs
        self._limits = limits
        self._lock = threading.Lock()
        self._staged: dict[str, _Staged] = {}
        remove_leftovers(scratch_dir)
        prefix = f"{_PREFIX}-{socket.gethostname()}-{os.getpid()}-"
        self._folder = Path(tempfile.mkdtemp(prefix=prefix, dir=scratch_dir))

    @contextmanager
    def submission(self, archive_sha256: str) -> Iterator[Path]:
        """The folder of an unpacked submission, there as long as the block runs.

        Raises:
            ServiceError: the stored file cannot be read.
            ArchiveRejected: it breaks a rule, although the upload checked it.
        """
        with self._lock:
            staged = self._staged.setdefault(archive_sha256, _Staged(folder=self._folder / archive_sha256))
            staged.users += 1
        try:
            with staged.lock:
                if staged.submission_dir is None:
                    staged.submission_dir = self._unpack(archive_sha256, staged.folder)
            yield staged.submission_dir
        finally:
            with self._lock:
                staged.users -= 1
                self._forget_idle()

    def close(self) -> None:
        """Removes everything."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _unpack(self, archive_sha256: str, folder: Path) -> Path:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        archive = folder / "archive.zip"
        self._blobs.fetch(archive_sha256, archive)
        submission_dir = unpack(archive, folder / "unpacked", self._limits)
        archive.unlink()
        return submission_dir

    def _forget_idle(self) -> None:
        idle = [digest for digest, staged in self._staged.items() if not staged.users]
        for digest in idle[:-KEPT_IDLE]:
            shutil.rmtree(self._staged.pop(digest).folder, ignore_errors=True)


def remove_leftovers(scratch_dir: Path) -> None:
    """Removes folders of workers of this machine that were killed."""
    prefix = f"{_PREFIX}-{socket.gethostname()}-"
    for folder in scratch_dir.glob(f"{prefix}*"):
        pid = folder.name.removeprefix(prefix).partition("-")[0]
        if pid.isdigit() and not Path(f"/proc/{pid}").exists():
            shutil.rmtree(folder, ignore_errors=True)
