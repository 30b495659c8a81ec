"""Stores the shards that an evaluation on this machine has finished, so that it continues after an interruption."""

import hashlib
import os
import re
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from pydantic import ValidationError

from ..episodes.records import EpisodeRecord
from ..shards.order import ShardOrder, ShardResult
from ..strict_model import StrictModel
from ..tracks.registry import find_version
from ..version import platform_class

# A shard that was neither finished nor used again for this time [s] is removed.
_UNUSED_S = 30 * 86400.0
# What a result depends on is in the name of what is played; these say only where it lies, which process plays it, and
# what would be learned again.
_NO_CONTENT = frozenset({"submission", "sensor", "coefficients"})
# Begins the name of a file that is being written.
_UNFINISHED = "unfinished-shard-"
# Names that are given here; whatever else lies in the folder is not ours to remove.
_OWN_NAME = re.compile(rf"[0-9a-f]{{64}}\.json|{_UNFINISHED}\w+")


class FinishedShard(StrictModel):
    """A shard with all its records."""

    records: tuple[EpisodeRecord, ...]
    result: ShardResult

    def answers(self, order: ShardOrder) -> bool:
        """Return whether it is the shard of an order that names its episodes."""
        played = {(record.task, record.episode) for record in self.records}
        return self.result.index == order.shard and played == {(order.task, it) for it in order.episodes or ()}


class StoredShards:
    """Finished shards in a folder, one file each, named by all that decides what is in it.

    Args:
        folder: made where it is not there.
        of: digest of what is played; for the standard estimator that of the sensor.
    """

    def __init__(self, folder: Path, *, of: str) -> None:
        self._folder, self._of = folder, of
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            _remove_unused(folder)

    def load(self, order: ShardOrder) -> FinishedShard | None:
        """Return a finished shard; None where it was not stored, or its file is damaged or of another shard."""
        path = self._path(order)
        try:
            finished = FinishedShard.model_validate_json(path.read_bytes())
            os.utime(path)
        except (OSError, ValidationError):
            return None
        return finished if finished.answers(order) else None

    def store(self, order: ShardOrder, records: Sequence[EpisodeRecord], result: ShardResult) -> None:
        """Store a shard whose episodes all have a record; without disk space nothing is stored."""
        content = FinishedShard(records=tuple(records), result=result).model_dump_json().encode()
        with suppress(OSError):
            handle, name = tempfile.mkstemp(dir=self._folder, prefix=_UNFINISHED)
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(content)
                Path(name).replace(self._path(order))
            except OSError:
                Path(name).unlink()
                raise

    def _path(self, order: ShardOrder) -> Path:
        parts = (find_version(order.track), platform_class(), self._of, order.model_dump_json(exclude=set(_NO_CONTENT)))
        digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
        return self._folder / f"{digest}.json"


def _remove_unused(folder: Path) -> None:
    for path in folder.iterdir():
        if not _OWN_NAME.fullmatch(path.name):
            continue
        with suppress(OSError):  # another process has removed it, or it is a folder or not ours
            if time.time() - path.lstat().st_mtime > _UNUSED_S:
                path.unlink()
