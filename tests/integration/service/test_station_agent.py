"""`vitac station run` at twins: what it refuses before anything moves, and what neither its end nor a policy breaks."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from cli_service import CliService, cli_service
from databases import state_directory
from sqlalchemy import select
from vitac.cli.client.http import Client
from vitac.cli.client.submit import packed
from vitac.cli.demo.laboratory import TRACK, made_for_station
from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.server.accounts import stations
from vitac.server.database.models import EpisodeResult, Shard, SubmissionFile
from vitac.server.database.states import FileRole, WorkState
from vitac.server.principals import CONSOLE
from vitac.station.description import StationTask, make_station_track
from vitac.station.twin.grasp import Mounted
from vitac.station.twin.hidden import PUBLIC_SETTINGS
from vitac.station.twin.laboratory import TwinStation, twin_process, twin_station
from vitac.station.verification import verify_video
from worker_fakes import eventually

KEY = Mounted(StationTask.LOCK, "key1")
MAIN = "import sys; from vitac.cli.main import main; main(sys.argv[1:])"
LIMIT_S = 240.0
POLICY = """
import time
import numpy as np

class Policy:
    def reset(self, task):
        self.count = 0

    def act(self, observation):
        self.count += 1
        {act}
"""
SLOW_THEN_NAN = "time.sleep(0.2); return np.full(3, 0.0 if self.count == 1 else np.nan)"
"""Ten control periods for an answer, then no number."""


@dataclass(frozen=True, kw_only=True)
class Laboratory:
    """A service whose only task is one trial on a station, and the files of its agent."""

    service: CliService
    folder: Path
    key: str

    def describe(self, description: dict[str, Any]) -> None:
        (self.folder / "station.yaml").write_text(yaml.safe_dump(description))

    def start_agent(self) -> "subprocess.Popen[str]":
        (self.folder / "key").write_text(self.key)
        command = ["station", "run", str(self.folder / "station.yaml"), "--key", str(self.folder / "key")]
        environment = os.environ | self.service.environment | {"VITAC_LIMITS": '{"action_wall_s": 3}'}
        return subprocess.Popen(
            [sys.executable, "-c", MAIN, *command], env=environment, stderr=subprocess.PIPE, text=True
        )

    def submit(self, submission: Path) -> str:
        client = Client(server=self.service.address, token=self.service.environment["VITAC_TOKEN"])
        with made_for_station(submission) as folder, packed(folder) as archive:
            found = client.upload(archive, track=TRACK, on_position=lambda _: None)
        return str(found["evaluation"]["id"])

    def shard(self) -> Shard:
        """The newest one."""
        with self.service.database.transaction() as session:
            return session.scalars(select(Shard).order_by(Shard.id.desc()).limit(1)).one()

    def record(self) -> dict[str, Any]:
        """What the newest trial left behind, as soon as it is over."""
        eventually(lambda: self.shard().state is WorkState.DONE, LIMIT_S)
        with self.service.database.transaction() as session:
            return session.scalars(select(EpisodeResult).order_by(EpisodeResult.id.desc()).limit(1)).one().record


@pytest.fixture
def track() -> dict[str, Any]:
    return make_station_track(PegShape.CUBOID, 1, starts=1)


@pytest.fixture
def laboratory(track: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Laboratory]:
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / f"{TRACK}.yaml").write_text(yaml.safe_dump(track))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path / "tracks"))
    with cli_service(state_directory()) as service:
        with service.database.transaction() as session:
            key = stations.add_station(session, CONSOLE, "lab")
        yield Laboratory(service=service, folder=tmp_path, key=key)


@pytest.fixture
def twins() -> Iterator[TwinStation]:
    with twin_station(picture_period_s=0.001) as station:
        yield station


@pytest.mark.slow
def test_agent_is_refused_in_a_sentence_before_anything_moves(
    laboratory: Laboratory, twins: TwinStation, repository: Path
) -> None:
    laboratory.submit(repository / "examples" / "peg_insertion_heuristic")
    twins.stage.serial_number = "STAGE-2"
    laboratory.describe(twins.description)
    _, errors = (agent := laboratory.start_agent()).communicate(timeout=LIMIT_S)
    assert (agent.returncode, errors.count("stage: Expected serial number STAGE-1, got STAGE-2.")) == (1, 1), errors
    assert (twins.stage.position(), twins.gripper.position()) == ((0, 0, 0, 0), 0)
    waiting = laboratory.shard()
    assert (waiting.state, waiting.attempts, waiting.token) == (WorkState.QUEUED, 0, 0)


@contextmanager
def running_agent(laboratory: Laboratory) -> Iterator["subprocess.Popen[str]"]:
    with laboratory.start_agent() as agent:
        try:
            yield agent
        finally:
            agent.kill()


def submission(folder: Path, act: str) -> Path:
    folder.mkdir()
    (folder / "policy.py").write_text(POLICY.format(act=act))
    (folder / "submission.yaml").write_text(f"track: track_1\ntasks: [peg-insertion]\nname: {folder.name}\n")
    return folder


def check_video(laboratory: Laboratory, record: dict[str, Any]) -> None:
    """The stored video shows the code that the trial got, and is the one that the record names."""
    file = laboratory.folder / "trial.mjpeg"
    with laboratory.service.database.transaction() as session:
        stored = session.scalars(select(SubmissionFile).where(SubmissionFile.role == FileRole.VIDEO)).all()[-1]
    file.write_bytes(laboratory.service.blobs.read(stored.sha256))
    found = verify_video(file, EpisodeRecord.model_validate(record))
    assert (found.problems, found.code, found.shows_code) == ([], laboratory.shard().code, True)
    assert record["forces"]["part"]["peak_n"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("track", [make_station_track(KEY.shape, 1, starts=1, task=KEY.task) | {"name": TRACK}])
def test_agent_plays_the_lock(laboratory: Laboratory, repository: Path) -> None:
    with twin_process(PUBLIC_SETTINGS, mounted=KEY) as twin:
        laboratory.describe(twin.description)
        laboratory.submit(repository / "examples" / "lock_opening_trained")
        with running_agent(laboratory):
            record = laboratory.record()
    assert (record["outcome"], record["shape"], record["task"]) == ("success", "key1", "lock-opening-station")
    check_video(laboratory, record)


@pytest.mark.slow
def test_agent_outlives_a_bad_policy_and_loses_no_trial_when_it_is_stopped_or_killed(
    laboratory: Laboratory, repository: Path
) -> None:
    with twin_process(PUBLIC_SETTINGS) as twin:
        laboratory.describe(twin.description)
        with running_agent(laboratory) as agent:
            laboratory.submit(submission(laboratory.folder / "nan", SLOW_THEN_NAN))
            record = laboratory.record()
            assert (record["failure"]["code"], record["env_steps"]) == ("non_finite_action", 1)
            laboratory.submit(repository / "examples" / "peg_insertion_trained")
            eventually(lambda: laboratory.shard().state is WorkState.RUNNING, LIMIT_S)
            agent.send_signal(signal.SIGTERM)
            assert agent.wait(LIMIT_S) == 0
        given_back = laboratory.shard()
        assert (given_back.state, given_back.attempts, given_back.repeats) == (WorkState.QUEUED, 0, [])
        with running_agent(laboratory) as agent:
            eventually(lambda: laboratory.shard().state is WorkState.RUNNING, LIMIT_S)
            agent.kill()
        with running_agent(laboratory):
            record = laboratory.record()
        assert record["outcome"] == "success"
        check_video(laboratory, record)
        played = laboratory.shard()
        assert [each["cause"] for each in played.repeats] == ["lost"], played.repeats
