from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import typer
from vitac.cli.admin import consent
from vitac.cli.admin.consent import ChangedMeanwhile, ConsentMissing, change_as_shown, require_consent


class FakeSession:
    """Keeps what is committed, and tells whether a transaction is open."""

    def __init__(self) -> None:
        self.committed: list[int] = []
        self.added: list[int] = []
        self.is_open = False

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
