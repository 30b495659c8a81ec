import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import quick_worker
import service_factories
from cli_service import submission_folder
from databases import fresh_database
from vitac.cli.demo.command import short_isolation
from vitac.cli.service.web_server import bind

RUN = """
import sys
from vitac.cli.demo import command
from vitac.cli.main import main
from vitac.cli.service import process_tree
process_tree.WORKER_COMMAND = (sys.argv[1],)
command.WARM_UP = sys.argv[2]
main(["demo", *sys.argv[3:]])
"""
"""The demo with a worker that makes its results up, and without the physics."""


@dataclass(kw_only=True)
class DemoRun:
    """A demo over a database and a state directory of its own, as many times as a test wants."""

    folder: Path
    environment: dict[str, str]
    warm_up: str = "pass"

    def command(self, *arguments: str) -> Sequence[str]:
        given = [str(Path(quick_worker.__file__)), self.warm_up, "--submission", str(self.folder), *arguments]
        return [sys.executable, "-c", RUN, *given]

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Runs it to its end."""
        return subprocess.run(
            self.command(*arguments),
            env=self.environment | environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Starts one that stays."""
        return subprocess.Popen(
            self.command(*arguments),
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )


@dataclass(frozen=True, kw_only=True)
class FinishedDemo:
    """A demo and what its first run said."""

    demo: DemoRun
    first: subprocess.CompletedProcess[str]

    @property
    def token(self) -> Path:
        return Path(self.demo.environment["VITAC_STATE_DIR"]) / "demo-token"


@contextmanager
def new_demo(folder: Path) -> Iterator[DemoRun]:
    support = [str(Path(module.__file__ or "").parent) for module in (quick_worker, service_factories)]
    with fresh_database() as address:
        environment = {
            "PATH": "/usr/bin:/bin",
            "PYTHONPATH": os.pathsep.join([*support, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
            "PYTHONIOENCODING": "utf-8",
            "VITAC_DATABASE_URL": address,
            "VITAC_STATE_DIR": str(folder / "state"),
            "VITAC_PORT": "0",
        }
        yield DemoRun(folder=submission_folder(folder / "zero"), environment=environment)


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[DemoRun]:
    with new_demo(tmp_path) as demo:
        yield demo


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FinishedDemo]:
    """A demo that was run once, for tests that look at it or run it another time."""
    with new_demo(tmp_path_factory.mktemp("finished")) as demo:
        yield FinishedDemo(demo=demo, first=demo.run("--exit"))


@pytest.mark.slow
def test_evaluates_the_example_and_prints_leaderboard_and_addresses(finished: FinishedDemo) -> None:
    done = finished.first
    assert done.returncode == 0, done.stdout + done.stderr
    for shown in (
        "zero (0.4 KiB), team demo",
        "user: root, memory: cgroup-v1",
        "270 of 270 episodes, 180 successes",
        "66.7 %",
        "56.4 to 75.5 %",
        "3.00",
        "Result hash",
        "/sign-in with the token in",
        "The service has stopped.",
    ):
        assert shown in done.stdout
    assert max(len(line) for line in done.stdout.splitlines() if "http" not in line and "/" not in line) <= 80


@pytest.mark.slow
def test_a_second_run_reuses_all_episodes_and_keeps_its_token(finished: FinishedDemo) -> None:
    secret = finished.token.read_text()
    second = replace(finished.demo, warm_up="raise SystemExit('the physics is not needed')").run("--exit")
    assert second.returncode == 0, second.stderr
    assert finished.token.read_text() == secret
    assert finished.token.stat().st_mode & 0o777 == 0o600
    assert "all 270 episodes reused" in second.stdout
    assert "Physics" not in second.stdout
    assert result_hash(second) == result_hash(finished.first)


@pytest.mark.slow
def test_again_runs_all_episodes_once_more_at_another_port_with_another_token_where_those_do_not_do(
    finished: FinishedDemo,
) -> None:
    invalid = "vitac_" + "x" * 43
    finished.token.write_text(invalid)
    with bind("127.0.0.1", 0) as taken:
        taken.listen()
        port = taken.getsockname()[1]
        again = finished.demo.run("--exit", "--again", "--port", str(port))
    assert again.returncode == 0, again.stderr
    assert f"(port {port} is taken)" in again.stdout
    assert finished.token.read_text() != invalid
    assert "270 of 270 episodes, 180 successes" in again.stdout
    assert result_hash(again) == result_hash(finished.first)


@pytest.mark.slow
def test_stays_until_ctrl_c(finished: FinishedDemo) -> None:
    with finished.demo.start() as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "Ctrl-C stops it" in line:
                break
        process.send_signal(signal.SIGINT)
        assert "The service has stopped." in process.stdout.read()
    assert process.returncode == 0


@pytest.mark.slow
def test_ctrl_c_during_the_evaluation_says_what_is_stored(demo: DemoRun) -> None:
    demo.warm_up = "import time; time.sleep(600)"
    with demo.start("--exit") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "Physics" in line:
                break
        process.send_signal(signal.SIGINT)
        assert "Finished episodes are stored" in process.stdout.read()
    assert process.returncode == 130


@pytest.mark.slow
def test_a_sandbox_that_does_not_hold_ends_the_demo(demo: DemoRun) -> None:
    done = demo.run("--exit", VITAC_TEST_WORKER="refuses")
    assert done.returncode == 1
    assert "The worker runs no policies on this machine. The sandbox is not sound." in done.stderr


@pytest.mark.slow
def test_physics_that_do_not_compile_end_the_demo_and_name_the_log(demo: DemoRun) -> None:
    demo.warm_up = "raise SystemExit(3)"
    done = demo.run("--exit")
    assert done.returncode == 1
    assert "Compiling the physics failed (exit code 3)" in done.stderr
    assert "demo.log" in done.stderr


def test_a_missing_submission_says_what_to_do(demo: DemoRun, tmp_path: Path) -> None:
    demo.folder = tmp_path / "none"
    done = demo.run("--exit")
    assert done.returncode == 1
    assert "give --submission" in done.stderr


def test_a_setting_that_cannot_be_used_is_named(demo: DemoRun) -> None:
    done = demo.run("--exit", VITAC_PORT="many")
    assert done.returncode == 1
    assert "VITAC_PORT" in done.stderr


def test_says_who_runs_the_policy_and_what_holds_its_memory() -> None:
    assert short_isolation("user: root, memory: cgroup-v1, episodes: frozen-copy") == "user: root, memory: cgroup-v1"


def result_hash(done: subprocess.CompletedProcess[str]) -> str:
    return next(line.split()[-1] for line in done.stdout.splitlines() if "Result hash" in line)
