import pytest
from service_factories import (
    make_principal,
)
from vitac.server.db.engine import Database
from vitac.server.principals import Principal


@pytest.fixture
def principal(database: Database) -> Principal:
    with database.transaction() as session:
        return make_principal(session)
