from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import typer
from vitac.cli.admin import consent
from vitac.cli.admin.consent import (
    NOTHING_CHANGED,
    ChangedMeanwhile,
    ConsentMissing,
    change_as_shown,
    change_transaction,
    require_consent,
)


class FakeSession:
    """Keeps what is committed, and tells whether a transaction is open."""

    def __init__(self) -> None:
        self.committed: list[int] = []
        self.added: list[int] = []
        self.flushed: list[int] = []
        self.is_open = False

    def flush(self) -> None:
        self.flushed = list(self.added)

    def rollback(self) -> None:
        self.added.clear()

    @contextmanager
    def transaction(self) -> Iterator["FakeSession"]:
        self.is_open = True
        try:
            yield self
            self.committed += self.added
        finally:
            self.added.clear()
            self.is_open = False


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> FakeSession:
    made = FakeSession()
    monkeypatch.setattr(consent, "transaction", made.transaction)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    return made


def changed(
    session: FakeSession, *values: int, answer: bool = True, yes: bool = False, dry_run: bool = False
) -> list[int]:
    """Adds the values one after the other at each call; returns what was shown."""
    left = list(values)
    shown: list[int] = []

    def change(session: FakeSession) -> int:
        session.added.append(left.pop(0))
        return session.added[-1]

    def answered(question: str, *, abort: bool) -> None:
        assert (question, abort, session.is_open) == ("Sure?", True, False), "nothing is locked while somebody reads"
        if not answer:
            raise typer.Abort

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer, "confirm", answered)
        change_as_shown(change, shown.append, "Sure?", yes=yes, dry_run=dry_run)  # type: ignore[arg-type]
    return shown


def test_consent_is_needed_where_nobody_can_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConsentMissing, match="--yes"):
        require_consent("Cancel?", yes=False)
    require_consent("Cancel?", yes=True)


def test_a_change_is_made_as_it_was_shown_and_nothing_is_locked_meanwhile(session: FakeSession) -> None:
    assert changed(session, 1, 1) == [1]
    assert session.committed == [1]
    assert changed(session, 2, yes=True) == [2]
    assert changed(session, 3, dry_run=True) == changed(session, 3, dry_run=True, yes=True) == [3]
    assert session.committed == [1, 2]


def test_a_change_that_was_refused_or_is_another_one_now_is_not_made(session: FakeSession) -> None:
    with pytest.raises(typer.Abort):
        changed(session, 1, answer=False)
    with pytest.raises(ChangedMeanwhile, match="nothing was done"):
        changed(session, 1, 2)
    assert session.committed == []


def test_a_dry_run_lets_the_database_refuse_and_keeps_nothing(
    session: FakeSession, capsys: pytest.CaptureFixture[str]
) -> None:
    assert changed(session, 1, dry_run=True) == [1]
    assert (session.flushed, session.committed, session.is_open) == ([1], [], False)
    assert capsys.readouterr() == ("", f"{NOTHING_CHANGED}\n")
    assert changed(session, 2, yes=True) == changed(session, 2, 2) == [2]
    assert capsys.readouterr().err == "", "a change that is asked about is no dry run"


def change_one(
    session: FakeSession,
    *,
    dry_run: bool = False,
    yes: bool = False,
    question: str | None = None,
    refused: bool = False,
) -> None:
    with change_transaction(dry_run=dry_run, yes=yes, question=question) as opened:
        assert opened is session  # type: ignore[comparison-overlap]
        session.added.append(1)
        if refused:
            raise RuntimeError


def test_a_change_in_one_transaction_is_kept_with_consent_only(
    session: FakeSession, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    with pytest.raises(ConsentMissing, match="Sure"):
        change_one(session, question="Sure?")
    assert session.committed == []
    change_one(session, dry_run=True, question="Sure?")
    assert (session.flushed, session.committed) == ([1], [])
    assert capsys.readouterr().err == f"{NOTHING_CHANGED}\n"
    change_one(session, yes=True, question="Sure?")
    change_one(session)
    assert session.committed == [1, 1]
    assert capsys.readouterr() == ("", "")


def test_a_dry_run_that_is_refused_does_not_say_that_it_ran(
    session: FakeSession, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RuntimeError):
        change_one(session, dry_run=True, refused=True)
    assert (session.committed, session.added) == ([], [])
    assert capsys.readouterr().err == ""
