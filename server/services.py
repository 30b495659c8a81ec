"""What server, worker and command line need to work: settings, database, files; opened and closed in one place."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from vitac.server.db.engine import Database
from vitac.server.db.schema import upgrade
from vitac.server.postgres.embedded import EmbeddedPostgres
from vitac.server.settings import Settings
from vitac.server.storage.blobs import BlobStore


@dataclass(frozen=True, kw_only=True)
class Services:
    """Open connections of one process. `postgres` is None when VITAC_DATABASE_URL names a server."""

    settings: Settings
    database: Database
    blobs: BlobStore
    postgres: EmbeddedPostgres | None


@contextmanager
def open_services(settings: Settings) -> Iterator[Services]:
    """Start or find the database, bring its schema up to date and open the file store.

    Raises:
        VitacError: one of them cannot be used here; the message says what to do.
    """
    with ExitStack() as stack:
        postgres = None
        if settings.database_url is not None:
            address = settings.database_url.get_secret_value()
        else:
            postgres = stack.enter_context(EmbeddedPostgres(settings.state_dir, bin_dir=settings.postgres_bin_dir))
            address = postgres.cluster.dsn()
        database = Database(address)
        stack.callback(database.dispose)
        upgrade(database)
        settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=postgres)
