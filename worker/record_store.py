"""Stores the records of a shard from a thread of its own, those together that come within a moment; for `shard_run`."""

import threading
from collections.abc import Callable, Sequence

from vitac.evaluator.episodes.records import EpisodeRecord

TOGETHER_S = 0.5
"""Records that come within this time are stored in one transaction, which takes as long as that of a single one: about
as much CPU time of worker and database as two episodes take around their physics."""


class RecordStore:
    """Takes records while the shard runs on; every one is stored soon, and all are when `close` returns.

    Args:
        store: stores records; called from the thread.
        give_up: called, from the thread as well, when that has failed.
    """

    def __init__(self, store: Callable[[Sequence[EpisodeRecord]], None], give_up: Callable[[], None]) -> None:
        self._store = store
        self._give_up = give_up
        self._waiting: list[EpisodeRecord] = []
        self._lock = threading.Lock()
        self._has_come = threading.Event()
        self._closing = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="records", daemon=True)
        self._thread.start()

    def add(self, record: EpisodeRecord) -> None:
        """Take a record."""
        with self._lock:
            self._waiting.append(record)
        self._has_come.set()

    def close(self) -> None:
        """Wait until all records are stored.

        Raises:
            Exception: what `store` has raised.
        """
        self._closing.set()
        self._has_come.set()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        is_last = False
        while not is_last:
            self._has_come.wait()
            self._closing.wait(TOGETHER_S)
            self._has_come.clear()
            is_last = self._closing.is_set()
            try:
                self._store_waiting()
            except Exception as error:  # noqa: BLE001 - `close` raises it, in the thread that runs the shard
                self._error = error
                self._give_up()
                return

    def _store_waiting(self) -> None:
        with self._lock:
            records, self._waiting = self._waiting, []
        if records:
            self._store(records)
