"""Where this process writes its service events. Called by the commands that open the service."""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from structlog.typing import Processor
    from vitac.server.settings import LogFormat


def configure_events(stream: TextIO, form: LogFormat) -> None:
    """Write the service events of this process (ours and the libraries') to a stream, one line per event."""
    import structlog
    from vitac.server.settings import LogFormat

    first: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Processor] = [structlog.processors.format_exc_info]
    if form is LogFormat.JSON:
        last.append(structlog.processors.JSONRenderer(default=str))
    else:
        last.append(structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]))
    structlog.configure(
        processors=[*first, *last],
        logger_factory=structlog.PrintLoggerFactory(stream),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[*first, structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)


def keep_events_off_output() -> None:
    """Write service events to standard error unless `configure_events` was called: standard output is for results."""
    import structlog

    if not structlog.is_configured():
        structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))
