"""Runs PostgreSQL's own client programs, `pg_dump` and `pg_restore`, on a database of ours; called by `backup`."""

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from psycopg.conninfo import conninfo_to_dict, make_conninfo
from vitac.envs.errors import VitacError

from .binaries import find_binaries

_SERVICE = "vitac"


class DatabaseToolFailed(VitacError):
    """`pg_dump` or `pg_restore` is missing, older than the server, or could not do its work; it says why."""


def dump(
    address: str,
    destination: Path,
    *,
    snapshot: str,
    bin_dir: Path | None = None,
    without_rows_of: Sequence[str] = (),
) -> None:
    """Write a database's content, as an exported snapshot shows it, to a file in PostgreSQL's custom format.

    Args:
        address: of the database.
        destination: file to write.
        snapshot: name that `pg_export_snapshot()` gave in a transaction that is still open.
        bin_dir: folder with PostgreSQL's programs; found by itself if None.
        without_rows_of: tables that are empty in the dump.

    Raises:
        DatabaseToolFailed: it did not work.
    """
    arguments = ["--format=custom", "--no-owner", "--no-privileges", f"--snapshot={snapshot}", f"--file={destination}"]
    excluded = [f"--exclude-table-data={table}" for table in without_rows_of]
    _run("pg_dump", [*arguments, *excluded], address, bin_dir)


def restore(address: str, dump_file: Path, *, bin_dir: Path | None = None) -> None:
    """Write a dump into a database without tables, in one transaction.

    Raises:
        DatabaseToolFailed: it did not work; the database has no tables then.
    """
    arguments = ["--no-owner", "--no-privileges", "--exit-on-error", "--single-transaction"]
    _run("pg_restore", [*arguments, str(dump_file)], address, bin_dir)


def _run(program: str, arguments: list[str], address: str, bin_dir: Path | None) -> None:
    path = find_binaries(configured=bin_dir, programs=(program,)).bin_dir / program
    parameters: dict[str, Any] = conninfo_to_dict(address)
    with _secrets_apart(parameters) as environment:
        done = subprocess.run(  # noqa: S603 - our own choice of program
            [path, f"--dbname={make_conninfo(**parameters)}", *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        raise DatabaseToolFailed(f"{program} failed with exit code {done.returncode}: {done.stderr.strip()[-1000:]}")


@contextmanager
def _secrets_apart(parameters: dict[str, Any]) -> Iterator[dict[str, str]]:
    """Take the secrets out of the parameters, since everybody on the machine can list arguments; hand them over apart.

    libpq has a variable for the password, but the passphrase of a client key can only stand in a service file.
    """
    environment = dict(os.environ)
    password, passphrase = parameters.pop("password", None), parameters.pop("sslpassword", None)
    if password is not None:
        environment["PGPASSWORD"] = str(password)
    if passphrase is None:
        yield environment
        return
    if "service" in parameters:
        raise DatabaseToolFailed("An address with sslpassword and service cannot be used here; leave one of them out.")
    with NamedTemporaryFile("w", prefix="vitac-service-") as file:  # readable by us only
        file.write(f"[{_SERVICE}]\nsslpassword={passphrase}\n")
        file.flush()
        parameters["service"] = _SERVICE
        yield environment | {"PGSERVICEFILE": file.name}
