import logging
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog
from cli_service import CliService, cli_service


@pytest.fixture(autouse=True)
def _nobody_is_logged_in(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not in a test's own folder: matplotlib makes this one when it is first imported.
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))


@pytest.fixture(autouse=True)
def _other_tests_find_logging_as_it_was() -> Iterator[None]:
    # A command that runs in this process writes its events to a stream that pytest closes after the test.
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level
    structlog.reset_defaults()


@pytest.fixture
def service(tmp_path: Path) -> Iterator[CliService]:
    """A service with the team `Team A`, and commands that reach it."""
    with cli_service(tmp_path / "state") as service:
        yield service
