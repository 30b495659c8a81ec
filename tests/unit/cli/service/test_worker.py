import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from databases import state_directory

WORKER = "from vitac.cli.main import main; main(['worker'])"


@pytest.mark.slow
def test_a_worker_waits_for_the_database_of_a_server_and_starts_none() -> None:
    folder = state_directory()
    environment = {"VITAC_STATE_DIR": str(folder), "PATH": "/usr/bin:/bin"}
    with subprocess.Popen([sys.executable, "-c", WORKER], env=environment, stderr=subprocess.PIPE, text=True) as worker:
        assert worker.stderr is not None
        said = worker.stderr.readline()
        worker.terminate()
    assert "database_awaited" in said
    assert "`vitac serve`" in said
    assert list(Path(folder).iterdir()) == []
    shutil.rmtree(folder)


@pytest.mark.slow
def test_a_worker_that_a_scheduler_started_says_that_the_database_is_away() -> None:
    folder = state_directory()
    environment = {"VITAC_STATE_DIR": str(folder), "VITAC_DATABASE_WAIT_S": "0.1", "PATH": "/usr/bin:/bin"}
    command = [sys.executable, "-c", WORKER.replace("'worker'", "'worker', '--once'")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, "Nobody has started the database" in done.stderr) == (os.EX_TEMPFAIL, True), done.stderr
    shutil.rmtree(folder)
