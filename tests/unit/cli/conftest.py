from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_service import CliService, cli_service


@pytest.fixture(autouse=True)
def _nobody_is_logged_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def service(tmp_path: Path) -> Iterator[CliService]:
    """A service with the team `Team A`, and commands that reach it."""
    with cli_service(tmp_path / "state") as service:
        yield service
