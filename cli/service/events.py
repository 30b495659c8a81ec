"""Where this process writes its service events. Called by `serve`, `worker` and `demo`."""

from __future__ import annotations

import logging
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
