"""The shipped compose files, really run: upload, evaluation, kills, three workers, and the hash of `vitac evaluate`.

This needs a container engine and some minutes, so it runs only where VITAC_TEST_COMPOSE names the compose client:
`VITAC_TEST_COMPOSE="docker compose" ./vitac test tests/containers`, or with "podman-compose". Where no registry is
reachable, `stand_in_images.sh` makes the base images first.
"""

import json
import os
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from s3_server import BUCKET, CREDENTIALS, s3_server

CLIENT = shlex.split(os.environ.get("VITAC_TEST_COMPOSE", ""))
BASE_IMAGES = ("docker.io/library/python:3.11-slim-bookworm", "docker.io/library/postgres:17-bookworm")
FIND_IMAGE = (("image", "inspect"), ("pull", "--quiet"))
PASSWORDS = {"VITAC_POSTGRES_PASSWORD": "trial", "VITAC_POSTGRES_OWNER_PASSWORD": "owner"}
EXAMPLE = Path("examples/peg_insertion_heuristic/Track_1")
START_LIMIT_S = 300.0
EVALUATION_LIMIT_S = 1200.0

pytestmark = pytest.mark.skipif(
    not CLIENT, reason='no VITAC_TEST_COMPOSE, which names a compose client, such as "docker compose"'
)


@dataclass(frozen=True, kw_only=True)
class Composed:
    """A running composition and how to reach it."""

    repository: Path
    project: str
    address: str
    files: tuple[str, ...] = ("docker-compose.yml",)
    environment: dict[str, str] = field(default_factory=dict)

    @property
    def engine(self) -> str:
        return "podman" if "podman" in CLIENT[0] else "docker"

    def compose(self, *arguments: str) -> None:
        files = [part for name in self.files for part in ("-f", name)]
        done = subprocess.run(
            [*CLIENT, "-p", self.project, *files, *arguments],
            cwd=self.repository,
            env=os.environ | self.environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{arguments}: {done.stdout[-2000:]} {done.stderr[-4000:]}"

    def ask_engine(self, *arguments: str) -> str:
        return subprocess.run([self.engine, *arguments], capture_output=True, text=True).stdout

    def containers(self, service: str) -> list[str]:
        """Ids of the running containers of a service."""
        labels = {"project": self.project, "service": service}
        filters = [f"--filter=label=com.docker.compose.{name}={value}" for name, value in labels.items()]
        return self.ask_engine("ps", "--quiet", *filters).split()

    def remove(self) -> None:
        """Removes everything; containers by their label, because not every client's `down` knows of scaled ones."""
        label = f"--filter=label=com.docker.compose.project={self.project}"
        self.ask_engine("rm", "--force", "--volumes", *self.ask_engine("ps", "--all", "--quiet", label).split())
        self.compose("down", "--volumes")

    def kill(self, container: str) -> None:
        """Kills all processes in a container, as if it crashed; the engine's own kill would not start it again."""
        self.ask_engine("exec", "--user", "0", container, "sh", "-c", "kill -KILL -1")
        self.ask_engine("exec", container, "sh", "-c", "kill -KILL -1")

    def get(self, path: str, token: str | None = None) -> Any:
        """The JSON at a path; None while the service does not answer."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        try:
            answer = httpx.get(f"{self.address}{path}", headers=headers, timeout=10)
        except httpx.TransportError:
            return None
        return answer.json() if answer.status_code in {200, 202} else None

    def workers(self) -> int:
        ready = self.get("/ready")
        return ready["workers"]["alive"] if ready else 0


@contextmanager
def composed(repository: Path, *files: str, **environment: str) -> Iterator[Composed]:
    """The composition under a project name of its own; containers, volumes and networks are removed afterwards."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        bind = f"127.0.0.1:{free.getsockname()[1]}"
    service = Composed(
        repository=repository,
        project=f"vitac-trial-{os.getpid()}",
        address=f"http://{bind}",
        files=("docker-compose.yml", *files),
        environment={**PASSWORDS, "VITAC_BIND": bind, **environment},
    )
    require_base_images(service)
    try:
        service.compose("build")
        service.compose("up", "--detach")
        eventually(lambda: service.workers() == 1, START_LIMIT_S)
        yield service
    finally:
        service.remove()


def require_base_images(service: Composed) -> None:
    """Skips where the images that ours are made from can neither be found nor fetched."""
    for image in BASE_IMAGES:
        found = (
            subprocess.run([service.engine, *how, image], capture_output=True).returncode == 0 for how in FIND_IMAGE
        )
        if not any(found):
            pytest.skip(f"no image {image} here, and no registry that has it (stand_in_images.sh makes one)")


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """An evaluation of the example by a composition."""

    service: Composed
    token: str
    submission: str

    @property
    def evaluation(self) -> dict[str, Any]:
        found = self.service.get(f"/api/v1/submissions/{self.submission}", self.token)
        return found["evaluation"] if found else {"progress": {"episodes_done": 0}, "finished_at": None}

    def wait_for_episodes(self, at_least: int) -> None:
        eventually(lambda: self.evaluation["progress"]["episodes_done"] >= at_least, EVALUATION_LIMIT_S)
        assert self.evaluation["finished_at"] is None, "too late: the evaluation is over"

    def result_hash(self) -> str:
        eventually(lambda: self.evaluation["finished_at"] is not None, EVALUATION_LIMIT_S)
        final = self.evaluation
        assert (final["state"], final["verdict"]) == ("completed", None)
        return str(final["result_hash"])


def begin(service: Composed) -> Attempt:
    answer = httpx.post(f"{service.address}/api/v1/teams", json={"name": "Trial"}, timeout=60)
    token = answer.json()["token"]["secret"]
    environment = {"VITAC_SERVER": service.address, "VITAC_TOKEN": token}
    submitted = vitac("submit", str(service.repository / EXAMPLE), "--json", **environment)
    return Attempt(service=service, token=token, submission=json.loads(submitted)["id"])


def vitac(*arguments: str, **environment: str) -> str:
    program = Path(sys.executable).with_name("vitac")
    done = subprocess.run([program, *arguments], env=os.environ | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def eventually(holds: Callable[[], bool], limit_s: float) -> None:
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.5)


@pytest.fixture(scope="module")
def local_hash(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """What `vitac evaluate` gives here for the same submission."""
    result = tmp_path_factory.mktemp("local") / "result.json"
    vitac("evaluate", str(repository / EXAMPLE), "--json", str(result))
    return str(json.loads(result.read_text())["result_hash"])


def test_kills_and_more_workers_change_nothing(repository: Path, local_hash: str) -> None:
    with composed(repository) as service:
        attempt = begin(service)
        attempt.wait_for_episodes(5)
        service.kill(service.containers("worker")[0])
        service.compose("up", "--detach", "--no-recreate", "--scale", "worker=3")
        eventually(lambda: len(service.containers("worker")) == 3, START_LIMIT_S)
        attempt.wait_for_episodes(20)
        service.kill(service.containers("postgres")[0])
        attempt.wait_for_episodes(40)
        service.kill(service.containers("server")[0])
        eventually(lambda: service.workers() == 3, START_LIMIT_S)
        assert attempt.result_hash() == local_hash


def test_uploads_are_kept_in_a_bucket(repository: Path, local_hash: str, tmp_path: Path) -> None:
    with s3_server(tmp_path, host=own_address()) as s3:
        variables = CREDENTIALS | {
            "AWS_ENDPOINT_URL": s3.endpoint,
            "AWS_ALLOW_HTTP": "true",
            "VITAC_STORAGE_URL": f"s3://{BUCKET}/compose",
        }
        with composed(repository, "docker-compose.s3.yml", **variables) as service:
            attempt = begin(service)
            assert attempt.result_hash() == local_hash
            assert [key for key in s3.stored_keys() if key.startswith("compose/sha256/")]
            assert service.get("/ready")["storage"] == "ok"


def own_address() -> str:
    """This machine's address as containers reach it; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))
        return str(probe.getsockname()[0])
