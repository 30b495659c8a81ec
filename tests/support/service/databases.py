"""One embedded PostgreSQL per test run and a fresh migrated database per test; imported by tests that need it."""

import atexit
import fcntl
import os
import secrets
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, cast

import psycopg
from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Connection, Engine, QueuePool, create_engine, text
from vitac.server.database import engine
from vitac.server.database.embedded import EmbeddedPostgres
from vitac.server.database.engine import Database
from vitac.server.database.schema import upgrade

TEMPLATE = "vitac_template"
FAST = (
    *("fsync=off", "synchronous_commit=off", "full_page_writes=off"),
    *("autovacuum=off", "wal_level=minimal", "max_wal_senders=0"),
)
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
        if not administration().closed:  # as at the end of the process, when the cluster goes, too
            administration().execute(f"DROP DATABASE {name} WITH (FORCE)")


@contextmanager
def opened_database(template: str = TEMPLATE) -> Iterator[Database]:
    """A database as its template is. It is emptied afterwards and serves again, with its connections, where it can.

    Making and dropping one, and connections that know no table yet, took most of the time of most tests.
    """
    idle = _idle[template]
    kept = idle.pop() if idle else _KeptDatabase(template)
    yield kept.database
    if kept.restore():
        idle.append(kept)
    else:
        kept.drop()


TABLES = """
    SELECT format('%I', relname) FROM pg_class
    WHERE relkind = 'r' AND relnamespace = 'public'::regnamespace ORDER BY relname
"""
SEQUENCES = "SELECT format('%I', sequencename), last_value FROM pg_sequences ORDER BY 1"
CATALOG_AND_SIZE = """
    SELECT (SELECT count(*) FROM pg_attribute) || ' ' || (SELECT count(*) FROM pg_constraint) || ' '
        || (SELECT count(*) FROM pg_trigger WHERE tgenabled = 'O') || ' ' || (SELECT count(*) FROM pg_proc),
        pg_database_size(current_database())
"""
"""What changes with the schema, and the bytes of everything."""
CLIENTS = """
    SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND backend_type = 'client backend'
"""
GROWTH_BYTES = 8 << 20
"""A database that has grown by more is dropped: what was deleted would slow down the tests that come after."""


class _KeptDatabase:
    """A copy of a template that one test uses after the other."""

    def __init__(self, template: str) -> None:
        self._stack = ExitStack()
        self.database = Database(self._stack.enter_context(fresh_database(template)))
        with self.database.engine.connect() as connection:
            tables = connection.scalars(text(TABLES)).all()
            self._rows = {table: _copy_out(connection, table) for table in tables}
            self._state = self._read_state(connection)
        filled = (f"SELECT '{table}', EXISTS (SELECT FROM {table})" for table in tables)  # noqa: S608 - fixed names
        self._filled = text(" UNION ALL ".join(filled))

    def restore(self) -> bool:
        """Put back what the template holds; return whether that was possible."""
        pool = cast(QueuePool, self.database.engine.pool)
        if pool.checkedout():  # somebody still works with it
            return False
        with self.database.engine.begin() as connection:
            if connection.scalars(text(CLIENTS)).one() > pool.checkedin() + 1:  # or another process
                return False
            catalog, n_bytes, sequences = self._read_state(connection)
            if catalog != self._state[0] or n_bytes > self._state[1] + GROWTH_BYTES:
                return False
            connection.execute(text("SET LOCAL session_replication_role = replica"))  # no triggers, no foreign keys
            for table, has_rows in connection.execute(self._filled):
                rows = self._rows[table]
                if rows and _copy_out(connection, table) == rows:
                    continue
                if has_rows:
                    connection.execute(text(f"DELETE FROM {table}"))  # noqa: S608 - fixed names
                if rows:
                    _copy_in(connection, table, rows)
            for name, value in self._state[2].items():
                if sequences[name] != value:
                    connection.execute(text("SELECT setval(:name, :value, :is_called)"), _sequence(name, value))
        return True

    def drop(self) -> None:
        """Drop it."""
        self.database.dispose()
        self._stack.close()

    def _read_state(self, connection: Connection) -> tuple[str, int, dict[str, int | None]]:
        """The schema, the size of the database, and where its sequences are."""
        catalog, n_bytes = connection.execute(text(CATALOG_AND_SIZE)).one()
        return catalog, n_bytes, {name: value for name, value in connection.execute(text(SEQUENCES))}  # noqa: C416 - a row is no pair to mypy


_idle: dict[str, list[_KeptDatabase]] = defaultdict(list)


def _sequence(name: str, value: int | None) -> dict[str, Any]:
    return {"name": name, "value": value or 1, "is_called": value is not None}


def _copy_out(connection: Connection, table: str) -> bytes:
    """All rows of a table."""
    with _cursor(connection).copy(f"COPY {table} TO STDOUT") as copy:
        return b"".join(bytes(piece) for piece in copy)


def _copy_in(connection: Connection, table: str, rows: bytes) -> None:
    with _cursor(connection).copy(f"COPY {table} FROM STDIN") as copy:
        copy.write(rows)


def _cursor(connection: Connection) -> "psycopg.Cursor[Any]":
    return cast("psycopg.Connection[Any]", connection.connection.driver_connection).cursor()


def copied_database(address: str) -> AbstractContextManager[Database]:
    """A copy of a database that nobody is connected to, with all its rows; dropped afterwards."""
    return opened_database(str(conninfo_to_dict(address)["dbname"]))
