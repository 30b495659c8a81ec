import sys
from pathlib import Path

import pytest


@pytest.fixture
def fake_command(repository: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """What starts shard processes in this test, which have neither simulation nor sandbox."""
    command = (sys.executable, str(repository / "tests" / "support" / "evaluation" / "fake_shard_process.py"))
    monkeypatch.setattr("vitac.evaluator.shards.host_process.COMMAND", command)
    return command


@pytest.fixture
def one_fake_host(fake_command: tuple[str, str], shared_simulation: None) -> tuple[str, str]:
    """As `fake_command`, for evaluations that come to their own end, with a result or a failure."""
    return fake_command
