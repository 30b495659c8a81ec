"""The one row of the competition: kept as it is by who changes what depends on it, and left alone after the end."""

from datetime import UTC, datetime

import pytest
from sqlalchemy import update
from vitac.server.db.competition_row import competition_row, lock_competition, require_not_final
from vitac.server.db.engine import Database
from vitac.server.db.models import Competition
from vitac.server.db.row_locks import unless_held
from vitac.server.errors import ProblemCode, ServiceError

from competitions import make_competition, put_in_place

ENDED = datetime(2026, 9, 1, 12, 30, tzinfo=UTC)


def is_free(database: Database, *, shared: bool) -> bool:
    with database.transaction() as session:
        return unless_held(session, lambda: lock_competition(session, shared=shared)) is not None


def test_a_service_without_competition_has_nothing_to_lock_and_nothing_final(database: Database) -> None:
    with database.transaction() as session:
        assert competition_row(session) is None
        assert lock_competition(session) is lock_competition(session, shared=True) is None
    require_not_final(None)


def test_many_may_keep_it_as_it_is_and_one_alone_may_change_it(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition())
    with database.transaction() as session:
        assert lock_competition(session, shared=True) is competition_row(session)
        assert is_free(database, shared=True)
        assert not is_free(database, shared=False)
    with database.transaction() as session:
        lock_competition(session)
        assert not is_free(database, shared=True)
    assert is_free(database, shared=False)


def test_a_lock_sees_what_others_have_written_since_the_row_was_read(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition())
    with database.transaction() as session:
        read = competition_row(session)
        assert read is not None
        with database.transaction() as other:
            other.execute(update(Competition).values(frozen_at=ENDED))
        assert read.frozen_at is None
        assert lock_competition(session) is read
        assert read.frozen_at == ENDED


def test_a_final_competition_is_refused_by_its_title_and_end() -> None:
    row = Competition(definition={"title": "Cup of Gels"})
    require_not_final(row)
    row.finalized_at = ENDED
    with pytest.raises(ServiceError, match=r"^Cup of Gels is final since 2026-09-01 12:30:00 UTC\.") as refusal:
        require_not_final(row)
    assert refusal.value.code is ProblemCode.COMPETITION_FINAL
