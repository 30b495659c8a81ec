"""The shipped compose files, really run: upload, evaluation, kills, three workers, and the hash of `vitac evaluate`.

This needs a container engine and some minutes, so it runs only where VITAC_TEST_COMPOSE names the compose client:
`VITAC_TEST_COMPOSE="docker compose" ./vitac test tests/containers`, or with "podman-compose". Where no registry is
reachable, `stand_in_images.sh` makes the base images first. Each step has a time limit, and an engine that cannot run
what the compose files ask for is a reason to skip that is found within a minute.
"""

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from s3_server import BUCKET, CREDENTIALS, s3_server

CLIENT = shlex.split(os.environ.get("VITAC_TEST_COMPOSE", ""))
ENGINE = "podman" if CLIENT and "podman" in CLIENT[0] else "docker"
BASE_IMAGES = ("docker.io/library/python:3.11-slim-bookworm", "docker.io/library/postgres:17-bookworm")
SCALING_PODMAN_COMPOSE = (1, 4)
ANSWER_LIMIT_S = 20.0
"""For an engine's answer, or for a registry's."""
PASSWORDS = {"VITAC_POSTGRES_PASSWORD": "trial", "VITAC_POSTGRES_OWNER_PASSWORD": "owner"}
EXAMPLE = Path("examples/peg_insertion_heuristic/Track_1")
BUILD_LIMIT_S = 900.0
START_LIMIT_S = 180.0
EVALUATION_LIMIT_S = 600.0

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

    def compose(self, *arguments: str, limit_s: float = START_LIMIT_S) -> None:
        files = [part for name in self.files for part in ("-f", name)]
        command = [*CLIENT, "-p", self.project, *files, *arguments]
        done = run(command, limit_s=limit_s, cwd=self.repository, env=os.environ | self.environment)
        assert done.returncode == 0, f"{arguments}: {done.stdout[-2000:]} {done.stderr[-4000:]}"

    def containers(self, service: str) -> list[str]:
        """Ids of the running containers of a service."""
        labels = {"project": self.project, "service": service}
        filters = [f"--filter=label=com.docker.compose.{name}={value}" for name, value in labels.items()]
        return ask_engine("ps", "--quiet", *filters).stdout.split()

    def remove(self) -> None:
        """Removes everything; containers by their label, because not every client's `down` knows of scaled ones."""
        label = f"--filter=label=com.docker.compose.project={self.project}"
        remaining = ask_engine("ps", "--all", "--quiet", label).stdout.split()
        ask_engine("rm", "--force", "--volumes", *remaining, limit_s=START_LIMIT_S)
        self.compose("down", "--volumes")

    def describe(self) -> str:
        """What the containers do and have said last."""
        label = f"--filter=label=com.docker.compose.project={self.project}"
        names = ask_engine("ps", "--all", "--format={{.Names}}", label).stdout.split()
        logs = ((name, ask_engine("logs", "--tail=20", name)) for name in names)
        said = [f"--- {name}\n{log.stdout}{log.stderr}" for name, log in logs]
        return "\n".join([ask_engine("ps", "--all", label).stdout, *said])

    def wait_until(self, what: str, holds: Callable[[], bool], limit_s: float) -> None:
        deadline = time.monotonic() + limit_s
        while not holds():
            assert time.monotonic() < deadline, f"after {limit_s:.0f} s not yet {what}:\n{self.describe()}"
            time.sleep(0.5)

    def kill(self, container: str) -> None:
        """Kills all processes in a container, as if it crashed; the engine's own kill would not start it again."""
        ask_engine("exec", "--user", "0", container, "sh", "-c", "kill -KILL -1")
        ask_engine("exec", container, "sh", "-c", "kill -KILL -1")

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
    try:
        service.compose("build", limit_s=BUILD_LIMIT_S)
        service.compose("up", "--detach")
        for name in ("postgres", "server", "worker"):  # older clients say nothing when one does not start
            assert service.containers(name), f"{name} does not run:\n{service.describe()}"
        service.wait_until("one worker ready", lambda: service.workers() == 1, START_LIMIT_S)
        yield service
    finally:
        service.remove()


@pytest.fixture(scope="module", autouse=True)
def usable_engine() -> None:
    """Skips where client or engine cannot do what the compose files ask for."""
    version = ask_engine("version", client=CLIENT).stdout
    found = re.search(r"podman-compose\w* version +(\d+)\.(\d+)", version)
    if found and (int(found[1]), int(found[2])) < SCALING_PODMAN_COMPOSE:
        pytest.skip(f"{found[0]} ignores --scale; expected 1.4 or newer")
    for image in BASE_IMAGES:
        if not find_image(image):
            pytest.skip(f"no image {image} here, and no registry that has it (stand_in_images.sh makes one)")
    if '"vfs"' in ask_engine("info", "--format={{json .}}").stdout:
        pytest.skip(f"{ENGINE} copies whole images at each step of a build (storage driver vfs); use overlay")
    started = ask_engine("run", "--rm", "--init", "--read-only", BASE_IMAGES[0], "true")
    if started.returncode:
        pytest.skip(f"{ENGINE} cannot run a container: {started.stderr}")


def find_image(image: str) -> bool:
    if ask_engine("image", "inspect", image).returncode == 0:
        return True
    is_offered = ask_engine("manifest", "inspect", image).returncode == 0
    return is_offered and ask_engine("pull", "--quiet", image, limit_s=BUILD_LIMIT_S).returncode == 0


def ask_engine(
    *arguments: str, client: Sequence[str] = (ENGINE,), limit_s: float = ANSWER_LIMIT_S
) -> subprocess.CompletedProcess[str]:
    return run([*client, *arguments], limit_s=limit_s)


def run(command: Sequence[str], *, limit_s: float, **options: Any) -> subprocess.CompletedProcess[str]:
    """What a command says; it and all that it has started are ended, with code 124, when its time is over."""
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, start_new_session=True, **pipes, **options) as process:
        try:
            out, error = process.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            out, error = process.communicate()
            return subprocess.CompletedProcess(command, 124, out, f"{error}did not end within {limit_s:.0f} s")
    return subprocess.CompletedProcess(command, process.returncode, out, error)


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
        self.service.wait_until(
            f"{at_least} episodes done",
            lambda: self.evaluation["progress"]["episodes_done"] >= at_least,
            EVALUATION_LIMIT_S,
        )
        assert self.evaluation["finished_at"] is None, "too late: the evaluation is over"

    def result_hash(self) -> str:
        self.service.wait_until("finished", lambda: self.evaluation["finished_at"] is not None, EVALUATION_LIMIT_S)
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
    done = subprocess.run(
        [program, *arguments],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=EVALUATION_LIMIT_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


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
        service.wait_until("three workers", lambda: len(service.containers("worker")) == 3, START_LIMIT_S)
        attempt.wait_for_episodes(20)
        service.kill(service.containers("postgres")[0])
        attempt.wait_for_episodes(40)
        service.kill(service.containers("server")[0])
        service.wait_until("three workers ready", lambda: service.workers() == 3, START_LIMIT_S)
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
