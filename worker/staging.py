"""Submissions on the worker's disk: fetched once, archives also unpacked, while several shards of them run."""

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path

from vitac.evaluator.agent.isolation.memory_files import FileIsolation, default_file_isolation, memory_folder
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.sources import stage
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.storage.blobs import BlobStore
from vitac.server.storage.scratch import remove_leftovers, remove_unused, scratch_folder, shared_folder

KEPT_IDLE = 2
"""Unpacked submissions that stay although no shard of them runs: the next shard is often of the same one."""
WORKER_FOLDER = "worker"


@dataclass(kw_only=True)
class _Staged:
    """One submission on disk; `path` is set once it is there, `users` counts running shards.

    `exits` gives up what it holds besides.
    """

    folder: Path
    path: Path | None = None
    users: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)
    exits: ExitStack = field(default_factory=ExitStack)

    def remove(self) -> None:
        """Remove it from the disk, and from memory where no other process uses it."""
        self.exits.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class SubmissionStage:
    """Unpacked submissions below a folder of this process. Thread-safe; closed at the end of the worker."""

    def __init__(self, blobs: BlobStore, scratch_dir: Path, limits: Limits) -> None:
        self._blobs = blobs
        self._limits = limits
        self._scratch_dir = scratch_dir
        self._lock = threading.Lock()
        self._staged: dict[str, _Staged] = {}
        """Staged submissions by name, the most recently used last."""
        self._numbers = count()
        remove_leftovers(scratch_dir)
        remove_unused(self._image_base())
        self._exits = ExitStack()
        self._folder = self._exits.enter_context(scratch_folder(scratch_dir, WORKER_FOLDER))

    @contextmanager
    def submission(self, kind: SubmissionKind, archive_sha256: str) -> Iterator[Path]:
        """Return the folder of an unpacked model, or the file of a log, there as long as the block runs.

        Raises:
            ServiceError: the stored file cannot be read.
            ArchiveRejected: it breaks a rule, although the upload checked it.
        """
        fetch = partial(self._fetch_image if kind.form.is_image else self._fetch, kind, archive_sha256)
        with self._stage_once(f"{kind}-{archive_sha256}", fetch) as path:
            yield path

    def _image_base(self) -> Path:
        """Return where all processes of this machine unpack images: in memory where policies' files lie there."""
        in_memory = default_file_isolation() is FileIsolation.MEMORY
        return (memory_folder() if in_memory else self._scratch_dir) / f"vitac-images-{os.geteuid()}"

    @contextmanager
    def _stage_once(self, name: str, fetch: Callable[[_Staged], Path]) -> Iterator[Path]:
        """Yield what `fetch` puts into a folder of this name; simultaneous users share one."""
        with self._lock:
            # A new folder each time: a process that still runs must not match what is unpacked again.
            staged = self._staged.get(name) or _Staged(folder=self._folder / f"{name}-{next(self._numbers)}")
            self._staged[name] = staged
            staged.users += 1
        try:
            with staged.lock:
                if staged.path is None:
                    staged.path = self._whole(staged, fetch)
            yield staged.path
        finally:
            with self._lock:
                staged.users -= 1
                self._staged[name] = self._staged.pop(name)  # last, as the one used most recently
                self._forget_idle()

    @property
    def folder(self) -> Path:
        """For what else lives only while a shard runs; removed also after this process was killed."""
        return self._folder

    @contextmanager
    def file(self, sha256: str) -> Iterator[Path]:
        """Return a stored file as it is, there as long as the block runs.

        Raises:
            ServiceError: it cannot be read.
        """
        with self._stage_once(f"file-{sha256}", lambda staged: self._fetch_file(sha256, staged.folder)) as path:
            yield path

    def close(self) -> None:
        """Remove everything."""
        for staged in self._staged.values():
            staged.exits.close()
        self._exits.close()

    def _whole(self, staged: _Staged, fetch: Callable[[_Staged], Path]) -> Path:
        try:
            staged.folder.mkdir()
            return fetch(staged)
        except BaseException:
            staged.remove()  # perhaps the disk is full of it
            raise

    def _fetch_file(self, sha256: str, folder: Path) -> Path:
        path = folder / "file"
        self._blobs.fetch(sha256, path)
        return path

    def _fetch(self, kind: SubmissionKind, archive_sha256: str, staged: _Staged) -> Path:
        folder, upload = staged.folder, staged.folder / "upload"
        self._blobs.fetch(archive_sha256, upload)
        if not kind.form.is_archive:
            return upload
        submission_dir = stage(upload, folder / "unpacked", self._limits)
        upload.unlink()
        return submission_dir

    def _fetch_image(self, kind: SubmissionKind, archive_sha256: str, staged: _Staged) -> Path:
        def unpack(folder: Path) -> None:
            upload = staged.folder / "upload"
            self._blobs.fetch(archive_sha256, upload)
            stage(upload, folder, self._limits, kind)
            upload.unlink()

        return staged.exits.enter_context(shared_folder(self._image_base(), archive_sha256, unpack)) / "image"

    def _forget_idle(self) -> None:
        idle = [name for name, staged in self._staged.items() if not staged.users]
        for name in idle[:-KEPT_IDLE]:
            self._staged.pop(name).remove()
