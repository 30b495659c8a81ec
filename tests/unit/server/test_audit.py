"""The audit log's place in the public log: a line that is changed or removed later no longer agrees with its digest."""

from datetime import timedelta

import pytest
from service_factories import make_principal
from sqlalchemy import text
from vitac.server import audit
from vitac.server.accounts import teams
from vitac.server.audit import append_audit_digest, list_audit_digests
from vitac.server.database.engine import Database
from vitac.server.principals import CONSOLE


def register(database: Database) -> None:
    with database.transaction() as session:
        make_principal(session, "Ants")


def digests(database: Database, *, every: timedelta = timedelta()) -> list[tuple[int, bool]]:
    with database.transaction() as session:
        append_audit_digest(session, every=every)
        return [(digest.lines, digest.agrees) for digest in list_audit_digests(session)]


@pytest.mark.parametrize("tampering", ["UPDATE audit_log SET actor = 'nobody'", "DELETE FROM audit_log WHERE id = 1"])
def test_lines_that_were_changed_or_removed_do_not_agree_with_the_public_log(
    database: Database, monkeypatch: pytest.MonkeyPatch, tampering: str
) -> None:
    monkeypatch.setattr(audit, "SETTLED_AFTER", timedelta())
    assert digests(database) == []
    register(database)
    first = digests(database)
    assert [agrees for _, agrees in first] == [True]
    assert digests(database) == first, "no further lines"
    with database.transaction() as session:
        teams.rename(session, CONSOLE, teams.find(session, "Ants"), "Bees")
    assert digests(database, every=timedelta(hours=1)) == first, "not so soon"
    assert [agrees for _, agrees in digests(database)] == [True, True]
    with database.transaction() as session:
        session.execute(text("SET LOCAL session_replication_role = replica"))
        session.execute(text(tampering))
    assert digests(database)[0][1] is False


def test_lines_that_another_transaction_may_still_precede_wait(database: Database) -> None:
    register(database)
    assert digests(database) == []
