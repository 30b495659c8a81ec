import errno
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy.orm import Session
from structlog.testing import capture_logs
from vitac.errors import VitacError
from vitac.server.database.states import WorkKind
from vitac.server.queue.work import KINDS, Claim, LeaseLost
from vitac.worker import leased_run
from vitac.worker.leased_run import DATABASE_PATIENCE_S, FULL_DISK_PAUSE_S, LeasedRun, RunEnd

LONG = "many  words\n" * 200


class FakeDatabase:
    """Runs each change at once, and remembers how long it would have been tried."""

    def __init__(self) -> None:
        self.patience_s: list[float] = []

    def retrying(self, change: Callable[[Any], Any], *, give_up_after_s: float) -> Any:
        self.patience_s.append(give_up_after_s)
        return change(None)


class FakeProcess:
    def __init__(self) -> None:
        self.killed = threading.Event()

    def kill(self) -> None:
        self.killed.set()


class FakeRun(LeasedRun[FakeProcess]):
    """Does what a test gives it, and remembers what was said of it."""

    step = "brick was laid"

    def __init__(
        self,
        folder: Path,
        during: Callable[["FakeRun"], None],
        *,
        idle_timeout_s: float = 60.0,
        kind: WorkKind = WorkKind.SHARD,
    ) -> None:
        settings = SimpleNamespace(lease_renewal_s=0.01, shard_idle_timeout_s=idle_timeout_s, scratch_dir=folder)
        self.database = FakeDatabase()
        lease = Claim(work_id=3, kind=kind, token=1, attempt=1, waited_s=0.0)
        services = SimpleNamespace(settings=settings, database=self.database)
        super().__init__(services, lease, brick=7)  # type: ignore[arg-type]
        self.process = FakeProcess()
        self.said: list[object] = []
        self.renewed = threading.Semaphore(0)
        self.renewing: Callable[[], None] = lambda: None
        self.handing_back: Callable[[], None] = lambda: None
        self._during = during

    def _work(self) -> None:
        self._watch(self.process)
        self._during(self)
        if self.process.killed.is_set():
            raise OSError("The process was killed.")

    def _renew(self, session: Session) -> None:
        self.renewed.release()
        self.renewing()

    def _hand_back(self, session: Session, delay_s: float = 0.0) -> None:
        self.handing_back()
        self.said.append(delay_s)

    def _report_broken(self, session: Session, message: str, *, is_free: bool = True) -> None:
        self.said.append(message)


def raising(error: Exception) -> Callable[..., None]:
    def fail(*_: object) -> None:
        raise error

    return fail


def ended_by_kill(run: FakeRun) -> None:
    assert run.process.killed.wait(120.0)


def stopped_from_outside(run: FakeRun) -> None:
    run.stop()
    ended_by_kill(run)


def renewed_thrice(run: FakeRun) -> None:
    for _ in range(3):
        assert run.renewed.acquire(timeout=120.0)


def test_finished_work_leaves_no_thread_and_says_nothing(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, renewed_thrice)
    before = threading.active_count()
    assert run.run() is RunEnd.FINISHED
    assert (threading.active_count(), run.said, run.process.killed.is_set()) == (before, [], False)


def test_what_broke_is_reported_in_one_short_line_and_logged_with_its_name(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, raising(VitacError(LONG)))
    with capture_logs() as logged:
        assert run.run() is RunEnd.BROKE
    assert run.said == [" ".join(LONG.split())[:1000]]
    assert [(line["event"], line["error"]) for line in logged] == [("work_broke", run.said[0])]


def test_a_bug_is_not_taken_for_a_broken_machine(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        run.run()
    assert run.said == []


@pytest.mark.parametrize("has_space", [True, False], ids=["error says so", "disk shows it"])
def test_a_full_disk_hands_the_work_back_for_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_space: bool
) -> None:
    monkeypatch.setattr(leased_run, "has_space", lambda folder: has_space or folder != tmp_path)
    error = OSError(errno.ENOSPC, "No space left on device") if has_space else VitacError("exit code -7")
    run = FakeRun(tmp_path, raising(error))
    assert run.run() is RunEnd.HANDED_BACK
    assert run.said == [FULL_DISK_PAUSE_S]


def test_a_process_that_hangs_is_ended_and_the_message_says_what_it_did_not_do(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, ended_by_kill, idle_timeout_s=0.05)
    assert run.run() is RunEnd.BROKE
    assert run.said == ["No brick was laid within 0.05 s."]


def test_a_process_that_advances_is_ended_at_the_limit_of_its_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = replace(KINDS[WorkKind.SENSOR_CHECK], limit_s=0.2)
    monkeypatch.setattr(leased_run, "KINDS", {WorkKind.SENSOR_CHECK: limited})

    def advance(run: FakeRun) -> None:
        while not run.process.killed.wait(0.01):
            run._advance()

    run = FakeRun(tmp_path, advance, kind=WorkKind.SENSOR_CHECK)
    assert run.run() is RunEnd.BROKE
    assert run.said == ["It took longer than 0.2 s."]


def test_a_process_that_advances_does_not_hang(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    monkeypatch.setattr(leased_run, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def advance(run: FakeRun) -> None:
        for _ in range(3):
            now_s[0] += 20.0
            run._advance()
            renewed_thrice(run)

    assert FakeRun(tmp_path, advance, idle_timeout_s=30.0).run() is RunEnd.FINISHED


def test_a_stopped_run_kills_hands_back_at_once_and_has_little_patience(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, stopped_from_outside)
    assert run.run() is RunEnd.HANDED_BACK
    assert run.said == [0.0]
    assert run.database.patience_s[-1] == 5.0
    assert set(run.database.patience_s) <= {5.0, DATABASE_PATIENCE_S}


def test_a_run_that_was_stopped_before_kills_the_process_as_soon_as_there_is_one(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, lambda run: None)
    run.stop()
    assert run.run() is RunEnd.HANDED_BACK


def test_a_lost_lease_kills_and_nothing_more_is_said(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, ended_by_kill)
    run.renewing = raising(LeaseLost("another worker has it"))
    assert run.run() is RunEnd.LOST
    assert run.said == []


def test_a_lease_that_is_lost_when_it_is_handed_back_is_lost(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, stopped_from_outside)
    run.handing_back = raising(LeaseLost("another worker has it"))
    assert run.run() is RunEnd.LOST


def test_a_renewal_that_fails_is_logged_and_tried_again(tmp_path: Path) -> None:
    run = FakeRun(tmp_path, renewed_thrice)
    run.renewing = raising(RuntimeError("away"))
    with capture_logs() as logged:
        assert run.run() is RunEnd.FINISHED
    assert {(line["event"], line["error"], line["brick"]) for line in logged} == {("lease_not_renewed", "away", 7)}
