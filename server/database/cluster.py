"""One PostgreSQL data directory and the process that serves it; `embedded` decides when to start and stop it.

Layout of the folder `postgres` in the state directory:

    password, service-password, dsn, lock      0600, ours
    server.log               what PostgreSQL says
    binaries/                copies, only where the database's user cannot reach the installed ones
    cluster/data, /socket    0700, of the database's user (`nobody` when we are root)
"""

import hashlib
import os
import pwd
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import psycopg
import structlog
from psycopg import sql
from vitac.errors import VitacError

from ..settings import others_can_enter
from .binaries import (
    NOTICE_EVERY_S,
    PostgresBinaries,
    copy_binaries,
    find_binaries,
    forget_lock_files,
    wait_for_leftovers,
)

logger = structlog.get_logger(__name__)

DATABASE = "vitac"
SUPERUSER = "vitac"
"""Makes the database and the two roles below, and nothing else: what it runs could start programs."""
OWNER_ROLE = "vitac_owner"
"""Owns the tables, migrates and restores them."""
SERVICE_ROLE = "vitac_service"
"""Works with them, and can change no table's rules."""
SOCKET_PATH_LIMIT = 107  # bytes in sockaddr_un.sun_path, less the closing zero
MAX_CONNECTIONS = 500  # docs/capacity.md says for how many workers
STOP_LIMIT_S = 20.0
LOG_LIMIT_BYTES = 8 << 20
_SOCKET_NAME = ".s.PGSQL.5432"
_LAUNCHER = Path(__file__).with_name("launch.py")


class DatabaseStartFailed(VitacError):
    """The embedded database did not start; the message holds the end of its log."""


class StateDirectoryUnreachable(VitacError):
    """Root runs the database as `nobody`, who cannot reach the state directory: choose another VITAC_STATE_DIR."""


@dataclass(frozen=True, kw_only=True)
class Account:
    """The user that PostgreSQL runs as; it refuses to run as root."""

    uid: int
    gid: int

    @classmethod
    def read_current(cls) -> "Account":
        """Return `nobody` for root, otherwise the same user."""
        if os.geteuid() != 0:
            return cls(uid=os.geteuid(), gid=os.getegid())
        nobody = pwd.getpwnam("nobody")
        return cls(uid=nobody.pw_uid, gid=nobody.pw_gid)

    def is_other(self) -> bool:
        """Return whether the database's user is not ours."""
        return self.uid != os.geteuid()

    def own(self, path: Path) -> None:
        """Give a file or folder to this user."""
        if self.is_other():
            os.chown(path, self.uid, self.gid)


class Cluster:
    """A data directory with its programs, socket and password; at most one process at a time may use it (file lock)."""

    def __init__(self, state_dir: Path, *, bin_dir: Path | None = None, options: Sequence[str] = ()) -> None:
        self.folder = state_dir.absolute() / "postgres"
        self.options = tuple(options)
        self._bin_dir = bin_dir
        self._account = Account.read_current()

    @property
    def data_dir(self) -> Path:
        """Where PostgreSQL keeps everything."""
        return self.folder / "cluster" / "data"

    @property
    def socket_dir(self) -> Path:
        """Folder of the socket: in the cluster, or where that path would be too long a private temporary one."""
        inside = self.folder / "cluster" / "socket"
        if len(os.fsencode(inside / _SOCKET_NAME)) <= SOCKET_PATH_LIMIT:
            return inside
        name = hashlib.sha256(os.fsencode(self.folder)).hexdigest()[:16]
        return Path(tempfile.gettempdir()) / f"vitac-postgres-{os.geteuid()}-{name}"

    @property
    def dsn_file(self) -> Path:
        """File with the address and password of the service's role, for other processes of the same user."""
        return self.folder / "dsn"

    @property
    def lock_file(self) -> Path:
        """Locked by the one process that runs the database."""
        return self.folder / "lock"

    @property
    def log_file(self) -> Path:
        """What PostgreSQL writes to its standard error."""
        return self.folder / "server.log"

    def make_folder(self) -> None:
        """Create the folder, passable for the database's user.

        Raises:
            StateDirectoryUnreachable: a folder above lets nobody else through.
        """
        mode = 0o711 if self._account.is_other() else 0o700
        for folder in reversed([path for path in (self.folder, *self.folder.parents) if not path.exists()]):
            folder.mkdir(exist_ok=True)
            folder.chmod(mode)  # mkdir's own mode is cut by the umask
        if self._account.is_other() and not others_can_enter(self.folder):
            raise StateDirectoryUnreachable(
                f"Root runs the database as nobody, and that user cannot enter {self.folder}. "
                "Set VITAC_STATE_DIR to a folder below /var/lib or /srv, or run as a normal user."
            )

    def initialise(self) -> None:
        """Make data directory and password once; a half-made one of an interrupted first start is made again."""
        binaries = self._binaries()
        parent = self.data_dir.parent
        parent.mkdir(mode=0o700, exist_ok=True)
        self._account.own(parent)
        self._make_socket_dir()
        if not self.data_dir.exists():
            self._initdb(binaries)

    def start(self) -> "subprocess.Popen[bytes]":
        """Start the server; `wait_until_ready` returns when it takes connections.

        Must be called in a thread that lives as long as the server shall: its end is the server's. A server that is
        left by a killed starter is waited for.
        """
        self._make_socket_dir()
        wait_for_leftovers(self.data_dir.resolve())
        forget_lock_files(self.data_dir, self.socket_dir / _SOCKET_NAME)
        arguments = ["-D", str(self.data_dir), *self._server_options()]
        with self._open_log() as log:
            return self._launch(self._binaries().bin_dir / "postgres", arguments, log.fileno())

    def wait_until_ready(self, process: "subprocess.Popen[bytes]", stopping: threading.Event) -> bool:
        """Wait until the server takes connections, or `stopping` is set; return whether it does.

        There is no limit: a recovery that is ended begins again at the next start.

        Raises:
            DatabaseStartFailed: it ended.
        """
        began = noticed = time.monotonic()
        while not self._pid_file_says_ready(process.pid):
            if process.poll() is not None:
                raise DatabaseStartFailed(f"PostgreSQL ended with code {process.returncode}. {self._end_of_log()}")
            if stopping.wait(0.01):
                return False
            if time.monotonic() - noticed > NOTICE_EVERY_S:
                noticed = time.monotonic()
                logger.warning("database_still_starts", waited_s=round(noticed - began), says=self._end_of_log())
        return True

    def stop(self, process: "subprocess.Popen[bytes]") -> None:
        """Shut down fast, then at once, then kill; return when the process is gone."""
        for signal_number in (signal.SIGINT, signal.SIGQUIT, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(signal_number)
            try:
                process.wait(STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                continue
            return

    def make_database(self) -> None:
        """Create our database and its two roles in a fresh cluster and write the address file."""
        with psycopg.connect(self.dsn("postgres"), autocommit=True) as connection:
            for role in (OWNER_ROLE, SERVICE_ROLE):
                self._make_role(connection, role)
            if connection.execute("SELECT 1 FROM pg_database WHERE datname = %s", [DATABASE]).fetchone() is None:
                connection.execute(f"CREATE DATABASE {DATABASE} OWNER {OWNER_ROLE}")
        address = self.service_dsn()
        if not self.dsn_file.exists() or self.dsn_file.read_text() != address:  # the disk may be full by now
            _write_private(self.dsn_file, address)

    def _make_role(self, connection: psycopg.Connection, role: str) -> None:
        """Create an ordinary role, or give it the password of its file again."""
        password_file = self._password_file(role)
        if not password_file.exists():
            _write_private(password_file, secrets.token_urlsafe(32))
        made = connection.execute("SELECT 1 FROM pg_roles WHERE rolname = %s", [role]).fetchone()
        change = sql.SQL(f"{'ALTER' if made else 'CREATE'} ROLE {{}} LOGIN NOSUPERUSER PASSWORD {{}}")
        connection.execute(change.format(sql.Identifier(role), sql.Literal(password_file.read_text())))

    def dsn(self, database: str = DATABASE) -> str:
        """Return the address of a database of this cluster for its superuser, with the password."""
        return self._address(SUPERUSER, self._password_file(SUPERUSER), database)

    def owner_dsn(self) -> str:
        """Return the address of our database for the owner of the tables, with the password."""
        return self._address(OWNER_ROLE, self._password_file(OWNER_ROLE), DATABASE)

    def service_dsn(self) -> str:
        """Return the address of our database for the service, with the password."""
        return self._address(SERVICE_ROLE, self._password_file(SERVICE_ROLE), DATABASE)

    def _password_file(self, role: str) -> Path:
        names = {SUPERUSER: "password", OWNER_ROLE: "owner-password", SERVICE_ROLE: "service-password"}
        return self.folder / names[role]

    def _address(self, role: str, password: Path, database: str) -> str:
        host = quote(str(self.socket_dir), safe="")
        return f"postgresql://{role}:{password.read_text()}@/{database}?host={host}"

    def _binaries(self) -> PostgresBinaries:
        version_file = self.data_dir / "PG_VERSION"
        major = int(version_file.read_text()) if version_file.exists() else None
        binaries = find_binaries(configured=self._bin_dir, major=major)
        if self._account.is_other() and not others_can_enter(binaries.bin_dir):
            return copy_binaries(binaries, self.folder / "binaries")
        return binaries

    def _initdb(self, binaries: PostgresBinaries) -> None:
        unfinished = self.data_dir.with_name("data.unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        password = secrets.token_urlsafe(32)
        _write_private(self.folder / "password", password)
        # initdb runs as the database's user, who can read neither our file nor a pipe of ours.
        handed_over = self.data_dir.with_name("password")
        _write_private(handed_over, password)
        self._account.own(handed_over)
        arguments = ["-D", str(unfinished), "-U", SUPERUSER, "--auth=scram-sha-256", f"--pwfile={handed_over}"]
        arguments += ["--encoding=UTF8", "--locale=C", "--no-instructions"]
        with self._open_log() as log:
            code = self._launch(binaries.bin_dir / "initdb", arguments, log.fileno()).wait()
        handed_over.unlink()
        if code != 0:
            raise DatabaseStartFailed(f"initdb ended with code {code}. {self._end_of_log()}")
        unfinished.rename(self.data_dir)

    def _server_options(self) -> list[str]:
        # Only the private socket: nothing listens on the network. C locale and UTC: the same answers on every machine.
        settings = {
            "listen_addresses": "",
            "unix_socket_directories": str(self.socket_dir),
            "unix_socket_permissions": "0700",
            "max_connections": str(MAX_CONNECTIONS),
            "shared_buffers": "64MB",
            "timezone": "UTC",
            "log_timezone": "UTC",
            "logging_collector": "off",
        }
        pairs = [f"{name}={value}" for name, value in settings.items()]
        return [part for pair in (*pairs, *self.options) for part in ("-c", pair)]

    def _launch(self, program: Path, arguments: Sequence[str], log: int) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-I", "-S", str(_LAUNCHER)]
        command += [str(self._account.uid), str(self._account.gid), str(os.getpid()), str(program), *arguments]
        return subprocess.Popen(  # noqa: S603 - our own programs and paths
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            cwd="/",
            env={"PATH": "/usr/bin:/bin", "LC_ALL": "C"},
            start_new_session=True,
        )

    def _pid_file_says_ready(self, pid: int) -> bool:
        # An older file may still lie there after a kill, so the first line has to be our child.
        try:
            lines = (self.data_dir / "postmaster.pid").read_text().splitlines()
        except FileNotFoundError:
            return False
        return bool(lines) and lines[0] == str(pid) and lines[-1].strip() == "ready"

    def _make_socket_dir(self) -> None:
        folder = self.socket_dir
        folder.mkdir(mode=0o700, exist_ok=True)
        owner = folder.lstat()
        if folder.is_symlink() or owner.st_uid not in (os.geteuid(), self._account.uid):
            raise DatabaseStartFailed(
                f"{folder} belongs to somebody else (uid {owner.st_uid}). Remove it or set VITAC_STATE_DIR."
            )
        self._account.own(folder)

    def _open_log(self) -> "tempfile._TemporaryFileWrapper[bytes]":
        mode = "ab" if not self.log_file.exists() or self.log_file.stat().st_size < LOG_LIMIT_BYTES else "wb"
        return self.log_file.open(mode)  # type: ignore[return-value]

    def _end_of_log(self) -> str:
        lines = self.log_file.read_text(errors="replace").splitlines()[-5:]
        return f"The end of {self.log_file}: {' / '.join(lines)}"


def _write_private(path: Path, text: str) -> None:
    """Write a file that only we can read, whole or not at all."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.unfinished")
    unfinished.unlink(missing_ok=True)
    with os.fdopen(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text)
    unfinished.replace(path)
