"""`vitac demo --station`: a service, a twin of a laboratory, and its agent, which plays three trials."""

import shutil
import subprocess
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from vitac.envs.errors import VitacError
from vitac.server.settings import Settings

from ..client.follow import follow
from ..client.http import Client
from ..client.progress import EvaluationProgress
from ..client.status import require_score
from ..client.submit import packed
from ..rehearsal import Album
from ..service.stop_request import Interrupted, StopRequest
from .display import INDENT, DemoDisplay
from .laboratory import TRACK, made_for_station, running_laboratory
from .team import team_token

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
                found = client.upload(archive, track=TRACK, again=True, on_position=lambda _: None)
            agent = stack.enter_context(laboratory.agent("--pictures", str(pictures)))
            began = time.monotonic()
            progress = EvaluationProgress(console=self.display.console, indent=INDENT)
            found = follow(client, found["id"], progress, partial(self._pause, agent))
            require_score(found)
            outcomes = {each["episode"]: each["outcome"] for each in client.episodes(found["id"])}
            successes = list(outcomes.values()).count("success")
            self.display.line("Trials", f"{successes} of {len(outcomes)} succeeded", time.monotonic() - began)
            page = Album(pictures).write_page(f"{found['name']} on the twin of a laboratory", outcomes)
        self.display.addresses({"Pictures": page.resolve().as_uri()})

    def _pause(self, agent: "subprocess.Popen[bytes]") -> None:
        if self.stop.wait(POLL_S):
            raise Interrupted
        if agent.poll() is not None:
            raise AgentEnded(f"The agent ended with code {agent.returncode}; see the end of {self.log}.")
