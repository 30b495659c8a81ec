"""Opens the service's database and files for the commands that work on them directly: `serve`, `demo`, `admin`."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy.orm import Session
from vitac.server.services import Services
from vitac.server.settings import Settings

from .events import keep_events_off_output


def load_settings(**overrides: Any) -> Settings:
    """Build the settings of this process from the environment; command-line options take precedence.

    Raises:
        SettingsError: a value is invalid.
    """
    from vitac.server import settings

    return settings.load_settings(**{name: value for name, value in overrides.items() if value is not None})


@contextmanager
def open_service(settings: Settings, *, statement_timeout_s: float | None = None) -> Iterator[Services]:
    """Open storage and database (by default the embedded one) and migrate the schema to this version.

    Args:
        settings: of this process.
        statement_timeout_s: after which the database ends a statement; None: without limit.

    Raises:
        DatabaseUnreachable: the configured server does not answer or refuses us.
        VitacError: the embedded server does not start.
    """
    from vitac.server.services import open_services

    keep_events_off_output()
    with open_services(settings, statement_timeout_s=statement_timeout_s) as services:
        yield services


@contextmanager
def transaction() -> Iterator[Session]:
    """Open the service that the environment names and one transaction on its database."""
    with open_service(load_settings()) as services, services.database.transaction() as session:
        yield session
