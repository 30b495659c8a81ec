"""What is done regularly: the sweep for lost work, totals, the removal of what nobody needs."""

import shutil
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from uuid import UUID

import structlog
from sqlalchemy.exc import SQLAlchemyError

from ..accounts.merging import forget_contacts
from ..audit import DIGEST_EVERY, append_audit_digest
from ..database.metrics import RetryReason, TotalsWriter
from ..evaluations.lifecycle import give_up
from ..evaluations.superseding import supersede_outdated
from ..leaderboards.board_cache import forget_old_notes
from ..playbacks import work as playbacks
from ..playbacks.stills import ask_for_missing_stills
from ..queue.work import sweep
from ..queue.workers import declare, versions_here
from ..services import Services
from ..storage import stored_files
from ..storage.scratch import remove_leftovers
from ..submissions import partial_uploads
from ..submissions.files import stored_digests
from ..submissions.final_list import play_due

logger = structlog.get_logger(__name__)

PRUNE_EVERY_S = 3600.0
OTHERS_EVERY_S = 10.0
"""Seconds between two looks for playbacks that nobody can make, results without stills, evaluations of other versions,
final lists that are due and folders of killed processes. Whoever waits for one waits up to so much longer; lost work is
looked for in every round, because each worker does this beside its own."""
ORPHAN_KEPT = timedelta(hours=24)
"""An upload is stored before its row is committed, so a file without a row is left alone for this time."""


class Housekeeping:
    """A thread that sweeps and prunes from `start` to `stop`; it outlives restarts of the database.

    Args:
        services: of this process.
        sweeps: False in one of several processes that share a parent, which sweeps: it only writes its totals.
        supersedes: False in a worker: its server declares which evaluator the service has, and begins evaluations of
            another one again. A worker whose version or track files differ would take the server's evaluations away.
    """

    def __init__(self, services: Services, *, sweeps: bool = True, supersedes: bool = True) -> None:
        self._services = services
        self._supersedes = supersedes
        self._sweeps = sweeps
        self._declared: dict[str, str] = {}
        self._have_stills: set[UUID] = set()
        self._totals = TotalsWriter(services.instruments)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="housekeeping", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End after the round at work, and write what was counted since."""
        self._stopping.set()
        self._thread.join()
        try:
            self._totals.write(self._services.database)
        except SQLAlchemyError as error:
            _postpone(error)

    def _run(self) -> None:
        pruned_at = others_at = float("-inf")
        while not self._stopping.is_set():
            if self._sweeps:
                _tried(self._sweep)
            if self._sweeps and time.monotonic() - others_at >= OTHERS_EVERY_S:
                others_at = time.monotonic()
                _tried(self._sweep_others)
                _tried(lambda: remove_leftovers(self._services.settings.scratch_dir))
            _tried(lambda: self._totals.write(self._services.database))
            if self._sweeps and time.monotonic() - pruned_at > PRUNE_EVERY_S and _tried(lambda: prune(self._services)):
                pruned_at = time.monotonic()
                self._have_stills.clear()  # of old ones the playbacks may be gone now
            self._stopping.wait(self._services.settings.sweep_interval_s)

    def _sweep(self) -> None:
        with self._services.database.transaction() as session:
            done = sweep(session, self._services.settings, give_up=give_up)
        instruments = self._services.instruments
        instruments.shard_retries.labels(RetryReason.LEASE_EXPIRED).inc(done.queued_again)
        instruments.shards_given_up.inc(done.given_up)
        if done.queued_again or done.given_up:
            logger.info("swept", queued_again=done.queued_again, given_up=done.given_up)

    def _declare(self) -> None:
        """Say which evaluator the service has, where this server has not yet said so."""
        versions = versions_here()
        if versions != self._declared:
            with self._services.database.transaction() as session:
                declare(session, versions, self._services.settings.outdated_evaluations)
            self._declared = versions

    def _sweep_others(self) -> None:
        if self._supersedes:
            self._declare()
            with self._services.database.transaction() as session:
                supersede_outdated(session, self._services.settings)
            with self._services.database.transaction() as session:
                play_due(session)
            with self._services.database.transaction() as session:
                append_audit_digest(session, every=DIGEST_EVERY)
            with self._services.database.transaction() as session:
                ask_for_missing_stills(session, self._services.settings, self._have_stills)
        with self._services.database.transaction() as session:
            playbacks.give_up_unmade(session)


def _tried(work: Callable[[], None]) -> bool:
    """Do a part of the work, whatever becomes of the others; return whether it is done."""
    try:
        work()
    except Exception as error:  # noqa: BLE001 - one row that cannot be read must not end the sweep
        _postpone(error)
        return False
    return True


def _postpone(error: Exception) -> None:
    message = " ".join(str(error).split())[:300]
    logger.warning("housekeeping_postponed", error=message, kind=type(error).__name__)


def prune(services: Services) -> None:
    """Remove old playbacks, stored files that no row names, and uploads that were given up."""
    partial_uploads.remove_expired(services)
    with services.database.transaction() as session:
        playbacks.remove_old(session, services.settings)
        forget_contacts(session, services.settings)
        forget_old_notes(session)
        known = set(stored_digests(session)) | playbacks.stored_digests(session)
    for digest in services.blobs.list_older_than(ORPHAN_KEPT):
        if digest not in known:
            with services.database.transaction() as session:
                stored_files.remove_if_older(session, services.blobs, digest, ORPHAN_KEPT)
    oldest_kept = time.time() - ORPHAN_KEPT.total_seconds()
    for pattern in ("upload-*", "playback-*"):
        for path in services.settings.scratch_dir.glob(pattern):
            if path.lstat().st_mtime < oldest_kept:
                shutil.rmtree(path, ignore_errors=True)
