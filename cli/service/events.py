"""Where this process writes its service events. Called by the commands that open the service."""

from __future__ import annotations

import logging
import sys
from typing import TextIO


def write_events_to(stream: TextIO) -> None:
    """Write the service events of this process (ours and the libraries') to a stream, one line per event."""
    import structlog

    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        logger_factory=structlog.PrintLoggerFactory(stream),
        cache_logger_on_first_use=False,
    )
    logging.basicConfig(
        stream=stream, level=logging.WARNING, force=True, format="%(asctime)s %(levelname)s %(name)s %(message)s"
    )


def keep_events_off_output() -> None:
    """Write service events to standard error unless `write_events_to` was called: standard output is for results."""
    import structlog

    if not structlog.is_configured():
        structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))
