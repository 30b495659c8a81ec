"""`vitac demo`: a whole evaluation on this machine, from an empty state directory to a leaderboard."""

import os
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.errors import VitacError

from ..client.http import Client, Json
from ..client.progress import EvaluationProgress
from ..client.status import follow, has_ended, require_score
from ..client.submit import packed
from ..service.database import load_settings
from ..service.process_tree import RunningService, running_service
from ..service.stop_request import Interrupted, StopRequest
from ..service.web_server import bind_or_any, configure_events
from ..terminal.output import program_name
from .display import INDENT, TEAM, TOKEN_FILE, DemoDisplay, team_token

if TYPE_CHECKING:
    from vitac.server.database.models import Worker
    from vitac.server.settings import Settings

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "peg_insertion_trained"
MAX_SLOTS = 4
WORKER_START_LIMIT_S = 120.0
POLL_S = 0.25
WARM_UP = "import sys; from vitac.cli.demo.display import warm_up; warm_up(sys.argv[1])"
LOG = "demo.log"


class DemoRefused(VitacError):
    """The demo cannot run here; the message says what to do."""


def command(
    exit_after: Annotated[bool, typer.Option("--exit", help="Stop the service after the leaderboard.")] = False,
    again: Annotated[bool, typer.Option("--again", help="Run all episodes, including stored ones.")] = False,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port; if it is taken, a free one is used.")
    ] = None,
    submission: Annotated[Path, typer.Option(help="Submission to evaluate.")] = EXAMPLE,
    station: Annotated[
        bool, typer.Option("--station", help="Play three trials on a simulated station instead, by its agent.")
    ] = False,
) -> None:
    """Start the service, evaluate the example submission on it and show the leaderboard.

    The service then keeps running until Ctrl-C. Evaluated episodes are stored, and the next run reuses them.
    """
    if not submission.exists():
        raise DemoRefused(f"No submission found at {submission}. Run the demo in a checkout, or give --submission.")
    from vitac.evaluator.submission.sources import read_manifest_file

    display = DemoDisplay()
    if station:
        _play_on_a_station(submission, port, display)
        return
    settings = load_settings(port=port, worker_slots=min(usable_cores(), MAX_SLOTS))
    display.title(version("vitac-arena"))
    settings.state_dir.mkdir(parents=True, exist_ok=True)
    with (settings.state_dir / LOG).open("a") as log, StopRequest().listening() as stop:
        configure_events(log, settings.log_format)
        demo = Demo(
            settings=settings,
            display=display,
            stop=stop,
            submission=submission,
            track=read_manifest_file(submission).track,
            again=again,
            log=log.fileno(),
        )
        try:
            demo.run(stay=not exit_after)
        except Interrupted:
            display.interrupted()
            raise typer.Exit(130) from None


def _play_on_a_station(submission: Path, port: int | None, display: DemoDisplay) -> None:
    """Play three trials by the agent of a twin, in a service of its own."""
    from vitac.envs.extras import require_extra

    from ..rehearsal import STATION_MODULES
    from .laboratory import TRIALS, StationDemo, use_station_track

    require_extra("station", *STATION_MODULES, user="A station")
    state_dir = load_settings().state_dir / "station"
    use_station_track(state_dir / "tracks", starts=TRIALS, repeats=1)
    settings = load_settings(state_dir=state_dir, port=port)
    display.title(version("vitac-arena"))
    with StopRequest().listening() as stop:
        demo = StationDemo(settings=settings, display=display, stop=stop, submission=submission, log=state_dir / LOG)
        try:
            demo.run()
        except Interrupted:
            display.interrupted()
            raise typer.Exit(130) from None


@dataclass(frozen=True, kw_only=True)
class Demo:
    """One run of the demo.

    Attributes:
        settings: settings of the service.
        display: prints progress and results.
        stop: the request to stop.
        submission: folder or zip to evaluate.
        track: track that the submission names.
        again: run all episodes, including stored ones.
        log: file descriptor for service events.
    """

    settings: "Settings"
    display: DemoDisplay
    stop: StopRequest
    submission: Path
    track: str
    again: bool
    log: int

    def run(self, *, stay: bool) -> None:
        """Run the demo; with `stay` return only on a request to stop."""
        with ExitStack() as stack:
            service = self._start(stack)
            client = Client(server=service.address, token=team_token(service.database, self.settings.state_dir))
            submission = self._upload(client)
            if has_ended(submission):
                self._print_reused(submission)
            else:
                self._start_workers(service)
                submission = self._evaluate(service, client, submission["id"])
            require_score(submission)
            client.set_public(submission["id"], public=True)  # visitors of this service see what was played
            self._show(client, submission)
            if stay:
                self._stay(service)
        self.display.stopped(self.settings.state_dir)

    def _start(self, stack: ExitStack) -> RunningService:
        wanted = self.settings.port
        with self.display.stage("Service", "starting the database and the server") as stage:
            listener = bind_or_any(self.settings.host, wanted)
            service = stack.enter_context(
                running_service(self.settings, listener, workers=1, log=self.log, notify=self.display.note)
            )
            taken = listener.getsockname()[1] != wanted and wanted != 0
            stage.done(service.address + (f" (port {wanted} is taken)" if taken else ""))
        return service

    def _upload(self, client: Client) -> Json:
        with self.display.stage("Submission", "packing and uploading") as stage, packed(self.submission) as archive:
            submission = client.upload(archive, track=self.track, again=self.again, on_position=lambda _: None)
            stage.done(f"{submission['name']} ({archive.stat().st_size / 1024:.1f} KiB), team {TEAM}")
        return submission

    def _print_reused(self, submission: Json) -> None:
        progress = submission["evaluation"]["progress"]
        self.display.line(
            "Evaluation",
            f"all {progress['episodes_total']} episodes reused, nothing was run "
            f"({program_name()} demo --again runs them)",
        )

    def _start_workers(self, service: RunningService) -> None:
        with self.display.stage("Physics", "compiling, about half a minute on the first run") as stage:
            self._warm_up()
            stage.done("compiled and cached")
        with self.display.stage("Worker", "starting and testing the sandbox") as stage:
            service.workers.start()
            isolation = self._wait_for_worker(service)
            slots = self.settings.worker_slots
            stage.done(f"{slots} shard{'s' if slots > 1 else ''} at a time, {isolation}")

    def _warm_up(self) -> None:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and code
            [sys.executable, "-c", WARM_UP, self.track], stdin=subprocess.DEVNULL, stdout=self.log, stderr=self.log
        )
        while process.poll() is None:
            if self.stop.wait(POLL_S):
                process.kill()
                process.wait()
                raise Interrupted
        if process.returncode != 0:
            raise DemoRefused(
                f"Compiling the physics failed (exit code {process.returncode}); see the end of "
                f"{self.settings.state_dir / LOG}. The usual reasons are too little memory or disk space."
            )

    def _wait_for_worker(self, service: RunningService) -> str:
        """Wait until the worker is ready, and return how it isolates policies.

        Raises:
            DemoRefused: it does not start, or its sandbox is not safe.
        """
        from vitac.server.database.states import WorkerState

        deadline = time.monotonic() + WORKER_START_LIMIT_S
        while time.monotonic() < deadline:
            for worker in read_workers(service):
                if worker.state is WorkerState.READY:
                    return short_isolation(worker.isolation)
                if worker.state is WorkerState.REFUSING:
                    raise DemoRefused(f"The worker runs no policies on this machine. {worker.message}")
            self._pause(service)
        raise DemoRefused(
            f"No worker was ready within {WORKER_START_LIMIT_S:g} s; see the end of {self.settings.state_dir / LOG}."
        )

    def _evaluate(self, service: RunningService, client: Client, submission_id: str) -> Json:
        began = time.monotonic()
        progress = EvaluationProgress(console=self.display.console, indent=INDENT)
        submission = follow(client, submission_id, progress, partial(self._pause, service))
        self.display.line("Evaluation", describe_evaluation(submission), time.monotonic() - began)
        return submission

    def _pause(self, service: RunningService) -> None:
        """Wait for one polling period and restart workers that have ended.

        Raises:
            Interrupted: a request to stop was received.
        """
        if self.stop.wait(POLL_S):
            raise Interrupted
        service.restart_ended()

    def _show(self, client: Client, submission: Json) -> None:
        # On the leaderboard of all tasks a submission of one task counts 0 in the others.
        task = submission["tasks"][0] if len(submission["tasks"]) == 1 else None
        self.display.leaderboard(client.leaderboard(self.track, task=task), TEAM)
        self.display.addresses(
            {
                "Result hash": submission["evaluation"]["result_hash"],
                "Leaderboard": f"{client.server}/" + (f"tracks/{self.track}?task={task}" if task else ""),
                "Submission": f"{client.server}/submissions/{submission['id']}",
                "Sign in": f"{client.server}/sign-in with the token in {self.settings.state_dir / TOKEN_FILE}",
            }
        )

    def _stay(self, service: RunningService) -> None:
        if not service.workers.pids:
            service.workers.start()
        self.display.staying()
        self.stop.supervise(service.restart_ended)


def describe_evaluation(submission: Json) -> str:
    """Return how many episodes are done and how many of them were reused."""
    progress = submission["evaluation"]["progress"]
    total, reused = progress["episodes_total"], progress["episodes_reused"]
    stored = f", {reused} of them reused" if reused else ""
    return f"{progress['episodes_done']} of {total} episodes{stored}, {progress['successes']} successes"


def short_isolation(level: str) -> str:
    """Return the user and the memory limit from a worker's isolation, its first two parts."""
    return ", ".join(level.split(", ")[:2])


def read_workers(service: RunningService) -> "list[Worker]":
    """Return the workers that this demo started, as the database knows them."""
    from vitac.server.queue import workers

    with service.database.transaction() as session:
        return [worker for worker in workers.list_workers(session) if worker.pid in service.workers.pids]


def usable_cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0))
