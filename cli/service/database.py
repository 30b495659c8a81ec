"""Opens the service's database and files for the commands that work on them directly: `serve`, `demo`, `admin`."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..terminal.output import warn
from .web_server import keep_events_off_output

if TYPE_CHECKING:
    from vitac.server.services import Services
    from vitac.server.settings import Settings

SAID_AFTER_S = 10.0
"""Time after which a command says that it waits for the database."""
STATEMENT_TIMEOUT_S = 60.0


def load_settings(**overrides: Any) -> Settings:
    """Build the settings of this process from the environment; command-line options take precedence.

    Raises:
        ServiceSettingsError: a value is invalid.
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
def open_for_command() -> Iterator[Services]:
    """Open the service that the environment names for a command that nobody wants to wait for.

    Raises:
        DatabaseUnreachable: it does not answer, is lost meanwhile, or a statement takes too long, as behind a lock.
    """
    from vitac.server.database.availability import failures_explained

    with (
        _said_if_slow(),
        failures_explained(STATEMENT_TIMEOUT_S),
        open_service(load_settings(), statement_timeout_s=STATEMENT_TIMEOUT_S) as services,
    ):
        yield services


@contextmanager
def _said_if_slow() -> Iterator[None]:
    """Say on standard error what may be the reason, where the block has not ended by then."""
    sentence = (
        f"This has taken {SAID_AFTER_S:.0f} s: the database is busy, locked, or does not answer. "
        "Ctrl-C ends this command."
    )
    timer = threading.Timer(SAID_AFTER_S, warn, [sentence])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
