import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psycopg
import pytest
from databases import fresh_database, state_directory
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from psycopg.sql import SQL, Identifier
from worker_fakes import eventually

SERVE = "from vitac.cli.main import main; main()"


@pytest.fixture
def environment(tmp_path: Path) -> Iterator[dict[str, str]]:
    with fresh_database() as address:
        yield os.environ | {"VITAC_DATABASE_URL": address, "VITAC_STATE_DIR": str(tmp_path / "state")}


def serve(environment: dict[str, str], *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SERVE, "serve", "--port", "0", *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def first_lines(process: subprocess.Popen[str]) -> list[str]:
    """What it says when it serves: address, workers, how to stop."""
    assert process.stdout is not None
    return [process.stdout.readline() for _ in range(3)]


def address_of(process: subprocess.Popen[str]) -> str:
    return first_lines(process)[0].split()[-1]


def ask(url: str) -> httpx.Response:
    return httpx.get(url, timeout=60)


@contextmanager
def no_connections(address: str) -> Iterator[None]:
    """While the block runs a database ends its connections and takes no new ones, as while its server restarts."""
    name = str(conninfo_to_dict(address)["dbname"])
    with psycopg.connect(make_conninfo(address, dbname="postgres"), autocommit=True) as connection:
        connection.execute(SQL("ALTER DATABASE {} ALLOW_CONNECTIONS false").format(Identifier(name)))
        connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", [name])
        yield
        connection.execute(SQL("ALTER DATABASE {} ALLOW_CONNECTIONS true").format(Identifier(name)))


@pytest.mark.slow
def test_serves_pages_and_api_also_after_its_database_restarted_until_it_is_asked_to_stop(
    environment: dict[str, str],
) -> None:
    with serve(environment) as process:
        said = first_lines(process)
        address = said[0].split()[-1]
        assert ask(f"{address}/ready").json()["status"] == "ready"
        assert "No result is on the leaderboards yet" in ask(address).text
        assert ask(f"{address}/api/v1/submissions").json()["code"] == "missing_credentials"
        with no_connections(environment["VITAC_DATABASE_URL"]):
            refused = ask(f"{address}/api/v1/leaderboards/track_1")
            assert (refused.status_code, refused.json()["code"]) == (503, "database_unavailable")
            assert ask(f"{address}/ready").json()["database"] == "does not answer"
            assert ask(f"{address}/health").status_code == 200
        eventually(lambda: ask(f"{address}/ready").json()["status"] == "ready")
        assert ask(f"{address}/api/v1/leaderboards/track_1").status_code == 200
        process.send_signal(signal.SIGTERM)  # the next test interrupts it
        _, complaints = process.communicate(timeout=300)
    assert process.returncode == 0, complaints
    assert "none; start them with `vitac worker`" in said[1]
    assert "Traceback" not in complaints


@pytest.mark.slow
def test_brings_its_own_database_where_none_is_configured(environment: dict[str, str]) -> None:
    del environment["VITAC_DATABASE_URL"]
    environment["VITAC_STATE_DIR"] = str(state_directory())
    with serve(environment) as process:
        assert ask(f"{address_of(process)}/ready").json()["database"] == "ok"
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=300)
    assert process.returncode == 0


def test_an_unreachable_database_is_refused_with_what_to_check(environment: dict[str, str]) -> None:
    environment["VITAC_DATABASE_URL"] = "postgresql://nobody@127.0.0.1:9/none"
    environment["VITAC_DATABASE_WAIT_S"] = "0.1"
    with serve(environment) as process:
        _, complaints = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "No database answers at 127.0.0.1 port 9" in complaints
    assert "Check VITAC_DATABASE_URL" in complaints
    assert "Traceback" not in complaints


def test_a_wrong_password_is_refused_at_once_and_not_taken_for_a_restart(environment: dict[str, str]) -> None:
    address = urlsplit(environment["VITAC_DATABASE_URL"])
    wrong = address._replace(netloc=f"{address.username}:guess@{address.hostname or ''}")
    environment["VITAC_DATABASE_URL"] = wrong.geturl()
    environment["VITAC_DATABASE_WAIT_S"] = "600"
    with serve(environment) as process:
        _, complaints = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "password authentication failed" in complaints
    assert "guess" not in complaints


@pytest.mark.slow
def test_beyond_this_machine_it_needs_the_address_that_people_use(environment: dict[str, str]) -> None:
    with serve(environment, "--host", "0.0.0.0") as process:  # noqa: S104 - is refused
        assert process.stderr is not None
        said = process.stderr.read()
    assert (process.returncode, "Set VITAC_PUBLIC_URL" in said) == (1, True)
