import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import short_evaluation
from databases import fresh_database, state_directory
from honest_policy import HONEST
from service_client import Service, live_service
from service_factories import TASK, TRACK
from short_evaluation import StartWorker
from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.submission.archive import unpack
from vitac.evaluator.tracks import load_track
from vitac.server.evaluations import lifecycle
from vitac.server.settings import load_settings

QUICK = {"lease_s": 3.0, "lease_renewal_s": 0.8, "sweep_interval_s": 1.0, "worker_heartbeat_s": 1.0}
"""Leases that run out soon, so that lost work is found soon.

Nobody waits for a renewal or a heartbeat, and for a sweep only after three seconds of lease: looking three times a
second in a server and its workers took a tenth of these tests' CPU time.
"""


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    """A service whose evaluations are short."""
    monkeypatch.setattr(lifecycle, "cut", short_evaluation.short_cut)
    folder = state_directory()
    with (
        fresh_database() as address,
        live_service(load_settings(state_dir=folder, database_url=address, **QUICK)) as service,
    ):
        yield service
    shutil.rmtree(folder)


@pytest.fixture
def start_worker(live: Service) -> Iterator[StartWorker]:
    """Starts real worker processes on the service; whatever still runs at the end is ended."""
    environment = {f"VITAC_{name.upper()}": str(value) for name, value in QUICK.items()}
    environment |= {"VITAC_STATE_DIR": str(live.settings.state_dir), "VITAC_DATABASE_URL": live.database.address}
    with ExitStack() as stack:

        def start() -> "subprocess.Popen[bytes]":
            program = [sys.executable, str(Path(short_evaluation.__file__))]
            process = subprocess.Popen(program, env=os.environ | environment)
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        yield start


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> LocalEvaluation:
    """What `vitac evaluate` gives for the same submission and episodes."""
    folder = tmp_path_factory.mktemp("submission")
    (folder / "archive.zip").write_bytes(HONEST)
    submission_dir = unpack(folder / "archive.zip", folder / "unpacked")
    track = load_track(TRACK)
    return evaluate(
        submission_dir=submission_dir, track=track, task=track.tasks[TASK], episodes=short_evaluation.EPISODES
    )


@pytest.fixture(scope="session")
def undisturbed_hash(undisturbed: LocalEvaluation) -> str:
    """The hash of that evaluation."""
    assert undisturbed.result_hash is not None, undisturbed.failure
    return undisturbed.result_hash
