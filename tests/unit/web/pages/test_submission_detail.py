from collections.abc import Iterator

import pytest
from databases import opened_database
from service_factories import LOCK, TASK, make_principal, make_score, make_settings, submit_scored
from sqlalchemy import event
from vitac.server.database.engine import Database
from vitac.web.pages.submission_detail import read_detail


@pytest.fixture
def database() -> Iterator[Database]:
    with opened_database() as database:
        yield database


def test_a_submission_with_all_that_its_page_shows_is_read_by_few_statements_on_one_connection(
    database: Database,
) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        submit_scored(session, team, "first", {TASK: make_score(50), LOCK: make_score(40)})
        shown = submit_scored(session, team, "second", {TASK: make_score(75), LOCK: make_score(20)})
    settings = make_settings()
    done: list[str] = []
    event.listen(database.engine, "begin", lambda _: done.append("begin"))
    event.listen(database.engine, "before_cursor_execute", lambda *given: done.append(given[2]))
    for statements in (14, 8):  # the first one reads the boards and the episodes, too
        done.clear()
        with database.reading() as session:
            detail = read_detail(session, settings, team, shown.id)
        assert done.count("begin") == 1
        assert len(done) - 1 <= statements, "\n".join(done)
    assert (detail.submission.name, detail.episodes_with_output, list(detail.action_matches)) == ("second", 0, [])
    assert detail.submission.rank is not None
    assert {(result.submission_name, result.task) for result in detail.past} == {
        (name, task) for name in ("first", "second") for task in (TASK, LOCK)
    }
