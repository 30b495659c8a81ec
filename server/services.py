"""What server, worker and command line need to work: settings, database, files; opened and closed in one place."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Self

from .database.availability import DatabaseUnreachable, once_available
from .database.embedded import EmbeddedPostgres
from .database.engine import Database
from .database.metrics import Instruments
from .database.schema import upgrade
from .settings import Settings
from .storage.blobs import BlobStore
from .traces import require_packages


@dataclass(frozen=True, kw_only=True)
class Services:
    """Open connections of one process and what it counts. `postgres` is None if VITAC_DATABASE_URL names a server."""

    settings: Settings
    database: Database
    blobs: BlobStore
    postgres: EmbeddedPostgres | None
    instruments: Instruments = field(default_factory=Instruments)

    def make_trial(self) -> Self:
        """Return the same with a database that keeps no change, for a dry run."""
        return replace(self, database=self.database.make_trial())


@contextmanager
def open_services(
    settings: Settings,
    *,
    may_run_database: bool = True,
    awaits_database: bool = True,
    statement_timeout_s: float | None = None,
) -> Iterator[Services]:
    """Start or find the database, bring its schema up to date and open the file store.

    Args:
        settings: of this process.
        may_run_database: whether the embedded database is run by this process when no other one does.
        awaits_database: whether to wait without limit for another process that runs the embedded database.
        statement_timeout_s: after which the database ends a statement of this process; None: without limit.

    Raises:
        VitacError: one of them cannot be used here; the message says what to do.
    """
    require_packages()
    with ExitStack() as stack:
        postgres = None
        if settings.database_url is not None:
            address, owner = settings.database_url.get_secret_value(), settings.database_owner_url
            owner_address = owner.get_secret_value() if owner else address
        else:
            postgres = EmbeddedPostgres(
                settings.state_dir,
                bin_dir=settings.postgres_bin_dir,
                may_run=may_run_database,
                wait_s=None if awaits_database else settings.database_wait_s,
            )
            stack.callback(postgres.stop)
            address, owner_address = postgres.start(), postgres.cluster.owner_dsn()
        database = Database(address, owner_address=owner_address, statement_timeout_s=statement_timeout_s)
        stack.callback(database.dispose)
        try:
            once_available(database, upgrade, patience_s=settings.database_wait_s)
        except DatabaseUnreachable as error:
            raise DatabaseUnreachable(f"{error} {_advice(settings)}") from error
        settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=postgres)


def _advice(settings: Settings) -> str:
    if settings.database_url is not None:
        return "Check VITAC_DATABASE_URL and that the server runs, or unset it to use the embedded one."
    return f"See {settings.state_dir / 'postgres' / 'server.log'}."
