from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_service import CliService, cli_service


@pytest.fixture
def service(tmp_path: Path) -> Iterator[CliService]:
    """A service with the team `Team A`, and commands that reach it."""
    with cli_service(tmp_path / "state") as service:
        yield service
