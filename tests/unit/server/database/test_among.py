from uuid import uuid4

from service_factories import make_principal
from sqlalchemy import event, select
from vitac.server.database.engine import Database, among
from vitac.server.database.models import Team


def test_rows_of_any_number_of_ids_are_found_by_the_same_statement(database: Database) -> None:
    with database.transaction() as session:
        ids = [make_principal(session, f"Team {number}").team_id for number in range(3)]
        known = [found for found in ids if found is not None]
        session.flush()
        statements: set[str] = set()
        event.listen(session.connection(), "before_cursor_execute", lambda *given: statements.add(given[2]))
        for wanted in ([], known[:1], known, [*known, uuid4()], [known[0]] * 400):
            found = session.scalars(select(Team.id).where(among(Team.id, wanted))).all()
            assert set(found) == set(wanted) & set(known)
    assert len({statement for statement in statements if statement.startswith("SELECT")}) == 1
