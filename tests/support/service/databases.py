"""One embedded PostgreSQL per test run and a fresh migrated database per test; imported by tests that need it."""

import atexit
import fcntl
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import psycopg
from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Connection, Engine, create_engine
from vitac.server.database import engine
from vitac.server.database.embedded import EmbeddedPostgres
from vitac.server.database.engine import Database
from vitac.server.database.schema import upgrade

TEMPLATE = "vitac_template"
FAST = ("fsync=off", "synchronous_commit=off", "full_page_writes=off")
MEMORY = Path("/dev/shm")
MEMORY_USE = Path("/proc/meminfo")
NEEDED_BYTES = 4 << 30
"""Free memory with which folders are made there; those of a whole run take less than 1 GB."""
FOLDERS = "vitac-run-"
YOUNG_S = 60.0
"""A folder of this age may be somebody's who is about to hold it [s]."""


@cache
def place_of_folders() -> Path:
    """A disk in memory, where a database is made and dropped in a quarter of the time, or /tmp where that has no room.

    A disk that runs no programs does not do either: where others cannot reach PostgreSQL, it is copied and run there.
    """
    if not MEMORY.is_dir() or not os.access(MEMORY, os.W_OK):
        return Path("/tmp")
    found = os.statvfs(MEMORY)
    # What the disk may take, and what the machine has: that disk's own limit says nothing of others' use of memory.
    has_room = min(found.f_bavail * found.f_frsize, free_memory_bytes()) >= NEEDED_BYTES
    return MEMORY if has_room and not found.f_flag & os.ST_NOEXEC else Path("/tmp")


def free_memory_bytes() -> int:
    """What programs can still take before the machine swaps."""
    fields = dict(line.split(":") for line in MEMORY_USE.read_text().splitlines())
    return int(fields["MemAvailable"].removesuffix("kB")) * 1024


@cache
def remove_left_behind(place: Path) -> None:
    """Remove the folders of runs that were killed: the process that made a folder holds it until it ends."""
    for folder in place.glob(f"{FOLDERS}*"):
        try:
            found = folder.lstat()
            if found.st_uid != os.geteuid() or time.time() - found.st_mtime < YOUNG_S:
                continue
            handle = hold(folder)
        except OSError:  # somebody holds it or has removed it meanwhile, or it is no folder
            continue
        shutil.rmtree(folder, ignore_errors=True)
        os.close(handle)


def hold(folder: Path) -> int:
    """Lock a folder until what this returns is closed, at the latest when this process ends, however that happens.

    Raises:
        OSError: another one holds it, it cannot be opened, or it is a link or a file.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def state_directory() -> Path:
    """A new folder that the database's user can reach also when the tests run as root; pytest's own let nobody in."""
    place = place_of_folders()
    remove_left_behind(place)
    folder = Path(tempfile.mkdtemp(prefix=FOLDERS, dir=place))
    hold(folder)
    folder.chmod(0o711 if os.geteuid() == 0 else 0o700)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)  # memory is not for what tests leave behind
    return folder


@cache
def shared_cluster() -> EmbeddedPostgres:
    """The cluster of this test run, with a migrated template database; ended when the run ends."""
    folder = state_directory()
    postgres = EmbeddedPostgres(folder, options=FAST)
    postgres.start()
    atexit.register(postgres.stop)  # before its folder is removed: what was registered last comes first
    with psycopg.connect(postgres.cluster.dsn("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {TEMPLATE}")
        if connection.info.server_version >= 160_000:
            # The password again, hashed once and not 4,096 times: each test opens ten connections.
            connection.execute("SET scram_iterations = 1")
            user, password = sql.Identifier(connection.info.user), sql.Literal(connection.info.password)
            connection.execute(sql.SQL("ALTER ROLE {} PASSWORD {}").format(user, password))
    template = Database(postgres.cluster.dsn(TEMPLATE))
    upgrade(template)
    template.engine.connect().close()  # learns what the database tells of itself
    template.dispose()
    compile_statements_once(template.engine)
    return postgres


def compile_statements_once(first: Engine) -> None:
    """Let all later databases of this process keep their compiled statements with those of a first one.

    A process of the service has one database and compiles each statement once; a test would compile them all again,
    which took a quarter of its time. What a database tells of itself is asked once, too: all are of one cluster.
    """

    def create(*arguments: Any, **options: Any) -> Engine:
        made = create_engine(*arguments, **options)
        made.dialect.initialize = _ask_nothing  # type: ignore[method-assign]
        made.dialect = made.pool._dialect = first.dialect
        made._compiled_cache = first._compiled_cache
        return made

    engine.create_engine = create  # type: ignore[attr-defined]


def _ask_nothing(connection: Connection) -> None:
    """Leave what the first database has told as it is."""


@cache
def administration() -> "psycopg.Connection[psycopg.rows.TupleRow]":
    """The connection of this process that makes and drops databases: a new one takes a fifth of what these take."""
    connection = psycopg.connect(shared_cluster().cluster.dsn("postgres"), autocommit=True)
    atexit.register(connection.close)
    return connection


def make_template(name: str) -> Database:
    """A database of that name, for this whole run, as the first template is; dispose of it before it is copied."""
    administration().execute(f"CREATE DATABASE {name} TEMPLATE {TEMPLATE} STRATEGY file_copy")
    return Database(shared_cluster().cluster.dsn(name))


@contextmanager
def fresh_database(template: str = TEMPLATE) -> Iterator[str]:
    """Address of a new database, a copy of the migrated template; dropped afterwards, whoever is connected."""
    name = f"t_{secrets.token_hex(6)}"
    administration().execute(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY file_copy")
    try:
        yield shared_cluster().cluster.dsn(name)
    finally:
        administration().execute(f"DROP DATABASE {name} WITH (FORCE)")


@contextmanager
def opened_database(template: str = TEMPLATE) -> Iterator[Database]:
    """A new database, a copy of the migrated template; dropped afterwards."""
    with fresh_database(template) as address:
        database = Database(address)
        yield database
        database.dispose()


def copied_database(address: str) -> AbstractContextManager[Database]:
    """A copy of a database that nobody is connected to, with all its rows; dropped afterwards."""
    return opened_database(str(conninfo_to_dict(address)["dbname"]))
