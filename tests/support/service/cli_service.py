"""A whole service (API and pages) in this process over a database of its own, and the command line pointed at it."""

import io
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from uuid import UUID

import quick_worker
from databases import make_template, opened_database
from service_client import serving
from service_factories import make_principal, make_secret, make_settings, play_all, sha256, submit
from typer import Typer, testing
from typer.main import get_command
from typer.testing import CliRunner, Result
from vitac.cli.main import build_app
from vitac.server.accounts import teams
from vitac.server.database.engine import Database
from vitac.server.database.states import Role
from vitac.server.principals import Principal
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.web.application import create

from competitions import make_competition, put_in_place

POLICY = (
    "import numpy as np\n\nclass Policy:\n    def reset(self, task): ...\n    def act(self, o): return np.zeros(3)\n"
)
MANIFEST = "track: track_1\ntasks: [peg-insertion]\nname: zero\n"


@dataclass(frozen=True, kw_only=True)
class CliService:
    """A service and the environment by which commands reach it."""

    address: str
    database: Database
    environment: dict[str, str]
    blobs: BlobStore

    @contextmanager
    def playing(self) -> Iterator[None]:
        """Plays whatever gets queued while the block runs, with results made up."""
        stopping = threading.Event()

        def play() -> None:
            while not stopping.wait(0.05):
                quick_worker.play_queued(self.database)

        thread = threading.Thread(target=play)
        thread.start()
        try:
            yield
        finally:
            stopping.set()
            thread.join()

    def run(self, *arguments: str) -> Result:
        """Runs a command of `vitac` with this service in its environment."""
        return self.run_with_input("", *arguments)

    def run_with_input(self, text: str, *arguments: str, token: str | None = "") -> Result:
        """Runs a command with a standard input; with another or no (None) token in its environment."""
        environment = self.environment if token == "" else self.environment | {"VITAC_TOKEN": token or ""}
        return CliRunner().invoke(app_of(arguments[0]), list(arguments), input=text, env=environment)


@cache
def app_of(noun: str) -> Typer:
    """The command line for one noun.

    A process of `vitac` makes its commands once; making them for each of a test's commands took half of its time.
    """
    make_commands_once()
    return build_app([noun])


@cache
def make_commands_once() -> None:
    """Let typer's runner keep what it has made of a command line."""
    testing._get_command = cache(get_command)  # type: ignore[attr-defined]


@cache
def template_with_team(team: str) -> tuple[str, str]:
    """The name of a template in which this team is already, and its token."""
    name = f"vitac_team_{sha256(team)[:8]}"
    database = make_template(name)
    with database.transaction() as session:
        token = make_secret(session, make_principal(session, team))
    database.dispose()
    return name, token


@contextmanager
def cli_service(state_dir: Path, team: str = "Team A", **values: Any) -> Iterator[CliService]:
    """A service with one team, whose token the environment holds; it looks for no lost work."""
    template, token = template_with_team(team)
    with opened_database(template) as database:
        settings = make_settings(state_dir=state_dir, **values)
        settings.scratch_dir.mkdir(parents=True)
        services = Services(
            settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None
        )
        with serving(create(services, sweeps=False)) as (host, port):
            address = f"http://{host}:{port}"
            environment = {
                "VITAC_SERVER": address,
                "VITAC_TOKEN": token,
                "VITAC_DATABASE_URL": database.address,
                "VITAC_STATE_DIR": str(state_dir),
                "COLUMNS": "200",
                "XDG_CONFIG_HOME": str(state_dir / "config"),
            }
            yield CliService(address=address, database=database, environment=environment, blobs=services.blobs)


def submission_folder(path: Path, manifest: str = MANIFEST) -> Path:
    """Writes a small valid submission."""
    path.mkdir()
    (path / "submission.yaml").write_text(manifest)
    (path / "policy.py").write_text(POLICY)
    return path


def zip_of(**files: str) -> bytes:
    """A zip with these files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def evaluated_submission(service: CliService) -> tuple[Principal, UUID]:
    """A finished submission of Team A, where appeals are possible, and who speaks for the team."""
    with service.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        team = teams.find(session, "Team A")
        by = Principal(role=Role.TEAM, team_id=team.id, team_name=team.name)
        submission = submit(session, by)
    play_all(service.database, submission)
    return by, submission.id
