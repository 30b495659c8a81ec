"""A service with a laboratory: a twin, and the agent that plays on it. Called by `station` and a benchmark."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

import yaml
from vitac.errors import VitacError
from vitac.server.settings import Settings

from ..client.http import Client
from ..client.progress import EvaluationProgress
from ..client.status import follow, require_score
from ..client.submit import packed
from ..rehearsal import Album
from ..service.process_tree import RunningService, running_service
from ..service.stop_request import Interrupted, StopRequest
from ..service.web_server import bind_or_any
from .display import INDENT, DemoDisplay, team_token

if TYPE_CHECKING:
    from vitac.station.twin.grasp import Mounted
    from vitac.station.twin.hidden import FaultScript, HiddenSettings
    from vitac.station.twin.laboratory import RunningTwin

TRACK: Final = "station"
_NAME: Final = "twin"
_VITAC: Final = "import sys; from vitac.cli.main import main; main(sys.argv[1:])"
_STOP_S: Final = 30.0


@dataclass(frozen=True, kw_only=True)
class Laboratory:
    """A service, a twin whose devices a file describes, and the key of its station.

    Attributes:
        service: without workers.
        twin: in a process of its own.
        state_dir: of the service.
    """

    service: RunningService
    twin: "RunningTwin"
    state_dir: Path
    _log: int

    def start_agent(self, *options: str) -> "subprocess.Popen[bytes]":
        """Start `vitac station run`, whose service events go to the log."""
        file, key = _station_files(self.state_dir)
        return subprocess.Popen(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", _VITAC, "station", "run", str(file), "--key", str(key), *options],
            env=os.environ | {"VITAC_STATE_DIR": str(self.state_dir)},
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
        )

    @contextmanager
    def agent(self, *options: str) -> Iterator["subprocess.Popen[bytes]"]:
        """Run the agent inside the block; it gives the running trial back afterwards."""
        process = self.start_agent(*options)
        try:
            yield process
        finally:
            stop_agent(process)


def stop_agent(process: "subprocess.Popen[bytes]") -> None:
    """Ask an agent to end, and wait until it has."""
    process.terminate()
    try:
        process.wait(_STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def use_station_track(folder: Path, *, starts: int | None, repeats: int, mounted: "Mounted | None" = None) -> None:
    """Write the track of stations and name its folder in this process's environment; do so before tracks are read."""
    from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE
    from vitac.station.description import make_station_track
    from vitac.station.twin.grasp import CUBOID_PEG

    folder.mkdir(parents=True, exist_ok=True)
    task, shape = mounted or CUBOID_PEG
    content = make_station_track(shape, repeats, starts=starts, task=task) | {"name": TRACK}
    (folder / f"{TRACK}.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    os.environ[TRACKS_FOLDER_VARIABLE] = str(folder)


@contextmanager
def running_laboratory(
    settings: Settings,
    *,
    log: int,
    notify: Callable[[str], None],
    hidden: "HiddenSettings | None" = None,
    script: "FaultScript | None" = None,
) -> Iterator[Laboratory]:
    """Run service and twin inside the block.

    Args:
        settings: of the service.
        log: file descriptor for the agent's service events.
        notify: called with a sentence when a process has ended.
        hidden: what the twin is really like; public settings if None.
        script: what breaks; nothing if None.
    """
    from vitac.station.twin.hidden import PUBLIC_SETTINGS
    from vitac.station.twin.laboratory import twin_process

    with ExitStack() as stack:
        twin = stack.enter_context(twin_process(hidden or PUBLIC_SETTINGS, script=script))
        listener = bind_or_any(settings.host, settings.port)
        service = stack.enter_context(running_service(settings, listener, workers=0, log=log, notify=notify))
        file, key = _station_files(settings.state_dir)
        file.write_text(yaml.safe_dump(twin.description, sort_keys=False), encoding="utf-8")
        key.touch(mode=0o600)
        key.write_text(_add_station(service), encoding="utf-8")
        yield Laboratory(service=service, twin=twin, state_dir=settings.state_dir, _log=log)


@contextmanager
def made_for_station(submission: Path) -> Iterator[Path]:
    """Yield a copy of a submission whose manifest names the track of stations; its code is the same."""
    from vitac.evaluator.submission.names import MANIFEST_NAME
    from vitac.evaluator.submission.sources import find_submission
    from vitac.evaluator.tracks import load_track

    track = load_track(TRACK)
    with TemporaryDirectory() as folder:
        copy = Path(folder) / track.folder
        shutil.copytree(find_submission(submission), copy)
        manifest = yaml.safe_load((copy / MANIFEST_NAME).read_text(encoding="utf-8"))
        manifest |= {"track": TRACK, "tasks": list(track.tasks)}
        (copy / MANIFEST_NAME).write_text(yaml.safe_dump(manifest), encoding="utf-8")
        yield copy


def _station_files(state_dir: Path) -> tuple[Path, Path]:
    return state_dir / "station.yaml", state_dir / "station-key"


def _add_station(service: RunningService) -> str:
    """Return a new key of the station."""
    from vitac.server.accounts import stations
    from vitac.server.principals import CONSOLE

    with service.database.transaction() as session:
        if any(station.name == _NAME for station in stations.list_stations(session)):
            stations.remove_station(session, CONSOLE, _NAME)
            session.flush()
        return stations.add_station(session, CONSOLE, _NAME)


TRIALS: Final = 3
POLL_S: Final = 0.25


class AgentEnded(VitacError):
    """The agent ended before all trials were played; the end of the demo's log says why."""


@dataclass(frozen=True, kw_only=True)
class StationDemo:
    """One run of the demo on a station.

    Attributes:
        settings: of the service.
        display: prints progress and results.
        stop: the request to stop.
        submission: to the track of the peg.
        log: file for service events.
    """

    settings: Settings
    display: DemoDisplay
    stop: StopRequest
    submission: Path
    log: Path

    def run(self) -> None:
        """Play the trials, and write a page with pictures of both gels.

        Raises:
            Interrupted: a request to stop was received.
            AgentEnded: as named.
        """
        pictures = self.settings.state_dir / "pictures"
        shutil.rmtree(pictures, ignore_errors=True)
        with ExitStack() as stack:
            log = stack.enter_context(self.log.open("ab")).fileno()
            with self.display.stage("Laboratory", "starting the service and a twin of the devices") as stage:
                laboratory = stack.enter_context(running_laboratory(self.settings, log=log, notify=self.display.note))
                stage.done(laboratory.service.address)
            client = Client(
                server=laboratory.service.address,
                token=team_token(laboratory.service.database, self.settings.state_dir),
            )
            with made_for_station(self.submission) as folder, packed(folder) as archive:
                submission = client.upload(archive, track=TRACK, again=True, on_position=lambda _: None)
            agent = stack.enter_context(laboratory.agent("--pictures", str(pictures)))
            began = time.monotonic()
            progress = EvaluationProgress(console=self.display.console, indent=INDENT)
            submission = follow(client, submission["id"], progress, partial(self._pause, agent))
            require_score(submission)
            outcomes = {each["episode"]: each["outcome"] for each in client.episodes(submission["id"])}
            successes = list(outcomes.values()).count("success")
            self.display.line("Trials", f"{successes} of {len(outcomes)} succeeded", time.monotonic() - began)
            page = Album(pictures).write_page(f"{submission['name']} on the twin of a laboratory", outcomes)
        self.display.addresses({"Pictures": page.resolve().as_uri()})

    def _pause(self, agent: "subprocess.Popen[bytes]") -> None:
        if self.stop.wait(POLL_S):
            raise Interrupted
        if agent.poll() is not None:
            raise AgentEnded(f"The agent ended with code {agent.returncode}; see the end of {self.log}.")
