import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
from databases import fresh_database
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from vitac.server.database import binaries
from vitac.server.database.binaries import DatabaseToolFailed, dump_database, restore_database


@pytest.fixture
def target() -> Iterator[str]:
    with fresh_database(template="template0") as address:
        yield address


@pytest.fixture
def dump_file(tmp_path: Path) -> Path:
    file = tmp_path / "database.dump"
    with fresh_database(template="template0") as address, psycopg.connect(address) as connection:
        connection.execute("CREATE TABLE kept AS SELECT 7 AS value")
        connection.commit()
        row = connection.execute("SELECT pg_export_snapshot()").fetchone()
        assert row is not None
        dump_database(address, file, snapshot=row[0])
    return file


def kept(address: str) -> list[tuple[Any, ...]]:
    with psycopg.connect(address) as connection:
        return connection.execute("SELECT value FROM kept").fetchall()


def test_address_without_a_database_name_means_the_default_one(
    dump_file: Path, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters: dict[str, Any] = conninfo_to_dict(target)
    monkeypatch.setenv("PGDATABASE", str(parameters.pop("dbname")))
    restore_database(make_conninfo(**parameters), dump_file)
    assert kept(target) == [(7,)]


def test_parameters_of_the_address_reach_the_program(dump_file: Path, target: str) -> None:
    with pytest.raises(DatabaseToolFailed, match="read-only transaction"):
        restore_database(make_conninfo(target, options="-c default_transaction_read_only=on"), dump_file)


def test_password_is_in_the_environment_and_not_among_the_arguments(
    dump_file: Path, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    run = subprocess.run

    def note_and_run(arguments: list[Any], **options: Any) -> Any:
        if Path(arguments[0]).name == "pg_restore" and "--version" not in arguments:
            calls.append((" ".join(map(str, arguments)), options["env"]["PGPASSWORD"]))
        return run(arguments, **options)

    monkeypatch.setattr(binaries.subprocess, "run", note_and_run)  # type: ignore[attr-defined]
    restore_database(target, dump_file)
    (arguments, password), *others = calls
    assert not others
    assert password == conninfo_to_dict(target)["password"]
    assert password not in arguments
    assert kept(target) == [(7,)]


def test_passphrase_of_a_client_key_is_in_a_private_file_and_not_among_the_arguments(
    dump_file: Path, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    run = subprocess.run

    def note_and_run(arguments: list[Any], **options: Any) -> Any:
        if Path(arguments[0]).name == "pg_restore" and "--version" not in arguments:
            file = Path(options["env"]["PGSERVICEFILE"])
            calls.append((" ".join(map(str, arguments)), file.read_text(), stat.S_IMODE(file.stat().st_mode), file))
        return run(arguments, **options)

    monkeypatch.setattr(binaries.subprocess, "run", note_and_run)  # type: ignore[attr-defined]
    restore_database(make_conninfo(target, sslpassword="open sesame"), dump_file)
    (arguments, content, mode, file), *others = calls
    assert not others
    assert "sesame" not in arguments
    assert "sslpassword=open sesame\n" in content
    assert mode == 0o600
    assert not file.exists()
    assert kept(target) == [(7,)]
