import asyncio
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from databases import fresh_database
from service_factories import LOCK, TASK, make_principal, make_score, make_settings, submit_scored
from sqlalchemy import event
from vitac.server.db.engine import Database
from vitac.server.db.states import FileRole
from vitac.server.errors import ServiceError
from vitac.server.submissions.files import add_files
from vitac.server.uploads.checked_upload import UploadedFile
from vitac.web.data.protocol import Visitor
from vitac.web.data.service import ServiceData

UNUSED = cast(Any, None)


@pytest.fixture
def database() -> Iterator[Database]:
    with fresh_database() as address:
        database = Database(address)
        yield database
        database.dispose()


def test_a_submission_with_all_that_its_page_shows_is_read_by_few_statements_on_one_connection(
    database: Database,
) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        submit_scored(session, team, "first", {TASK: make_score(50), LOCK: make_score(40)})
        shown = submit_scored(session, team, "second", {TASK: make_score(75), LOCK: make_score(20)})
    settings = make_settings()
    data = ServiceData(
        database=database,
        settings=settings,
        blobs=UNUSED,
        streams=UNUSED,
        registrations=UNUSED,
        sign_ins=UNUSED,
        playbacks=UNUSED,
        uploads=UNUSED,
    )
    visitor = Visitor(principal=team, token_id=UNUSED)
    done: list[str] = []
    event.listen(database.engine, "begin", lambda _: done.append("begin"))
    event.listen(database.engine, "before_cursor_execute", lambda *given: done.append(given[2]))
    for statements in (12, 7):  # the first one reads the boards and the episodes, too
        done.clear()
        detail = asyncio.run(data.submission(visitor, shown.id))
        assert done.count("begin") == 1
        assert len(done) - 1 <= statements, "\n".join(done)
    assert (detail.submission.name, detail.episodes_with_output, list(detail.action_matches)) == ("second", 0, [])
    assert detail.submission.rank is not None
    assert {(result.submission_name, result.task) for result in detail.past} == {
        (name, task) for name in ("first", "second") for task in (TASK, LOCK)
    }


def test_design_document_is_read_by_its_digest_and_is_missing_for_others(database: Database) -> None:
    with database.transaction() as session:
        team, other = make_principal(session), make_principal(session, "Others")
        mine = submit_scored(session, team, "first", {TASK: make_score(50)})
        brought = UploadedFile(
            role=FileRole.DOCUMENT, path=Path("gone"), sha256="d0" * 32, n_bytes=9, name="design.pdf", facts={}
        )
        add_files(session, mine.id, [brought])
    data = ServiceData(
        database=database,
        settings=make_settings(),
        blobs=cast(Any, SimpleNamespace(read=lambda sha256: f"stored as {sha256}".encode())),
        streams=UNUSED,
        registrations=UNUSED,
        sign_ins=UNUSED,
        playbacks=UNUSED,
        uploads=UNUSED,
    )
    found, content = asyncio.run(data.design_document(Visitor(principal=team, token_id=UNUSED), mine.id))
    assert (found.name, found.n_bytes, content.decode()) == ("design.pdf", 9, f"stored as {'d0' * 32}")
    with pytest.raises(ServiceError, match="no"):
        asyncio.run(data.design_document(Visitor(principal=other, token_id=UNUSED), mine.id))
