import io
import json
import logging

import structlog
from vitac.cli.service.web_server import configure_events
from vitac.server.settings import LogFormat


def written(form: LogFormat) -> list[str]:
    """What two events of ours, one of a library and an error are written as."""
    stream = io.StringIO()
    configure_events(stream, form)
    logger = structlog.get_logger("test")
    logger.info("worker_started", slots=2)
    logger.warning("two\nlines", text='a "quoted" word')
    logging.getLogger("library").warning("%d connections", 3)
    try:
        raise ValueError("broken")
    except ValueError:
        logging.getLogger("library").exception("failed")
        logger.exception("request_failed", path="/x")
    return stream.getvalue().splitlines()


def test_json_has_one_object_per_line_also_for_libraries_and_errors() -> None:
    events = [json.loads(line) for line in written(LogFormat.JSON)]
    assert [event["event"] for event in events] == [
        "worker_started", "two\nlines", "3 connections", "failed", "request_failed",
    ]  # fmt: skip
    assert [event["level"] for event in events] == ["info", "warning", "warning", "error", "error"]
    assert all(event["timestamp"].endswith("Z") for event in events)
    assert events[0]["slots"] == 2
    assert events[2]["logger"] == "library"
    assert all("ValueError: broken" in event["exception"] for event in events[3:])


def test_text_names_the_values() -> None:
    first = written(LogFormat.TEXT)[0]
    assert "level='info' event='worker_started' slots=2" in first
