import shutil

import psycopg
import pytest
from databases import state_directory
from sqlalchemy.exc import OperationalError
from vitac.server import services
from vitac.server.database.availability import DatabaseUnreachable
from vitac.server.database.engine import Database
from vitac.server.services import open_services
from vitac.server.settings import load_settings


def test_advice_for_the_embedded_database_names_its_log_and_no_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Database) -> None:
        raise OperationalError("ALTER TABLE", {}, psycopg.errors.LockNotAvailable("canceling statement"))

    monkeypatch.setattr(services, "upgrade", refuse)
    folder = state_directory()
    with pytest.raises(DatabaseUnreachable) as refusal, open_services(load_settings(state_dir=folder)):
        pass
    assert str(refusal.value) == f"The database cannot be used: canceling statement. See {folder}/postgres/server.log."
    shutil.rmtree(folder)
