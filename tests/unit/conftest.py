import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from shared_simulation import SharedProcesses, evaluate_with, loaded_once


@pytest.fixture
def fake_command(repository: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """What starts shard processes in this test, which have neither simulation nor sandbox."""
    command = (sys.executable, str(repository / "tests" / "support" / "evaluation" / "fake_shard_process.py"))
    monkeypatch.setattr("vitac.evaluator.shards.process.COMMAND", command)
    return command


@pytest.fixture(scope="module")
def processes() -> Iterator[SharedProcesses]:
    """What the evaluations of a file share that ask for `one_fake_host`."""
    with loaded_once() as loaded:
        yield loaded


@pytest.fixture
def one_fake_host(
    fake_command: tuple[str, str], processes: SharedProcesses, monkeypatch: pytest.MonkeyPatch
) -> tuple[str, str]:
    """As `fake_command`, for evaluations that come to their own end, with a result or a failure."""
    evaluate_with(processes, monkeypatch)
    return fake_command
