"""benchmarks/service.py: whose CPU time is whose."""

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
import service
from vitac.evaluator.agent.isolation import bubblewrap, process_tree
from vitac.evaluator.shards.host_process import COMMAND
from worker_fakes import eventually

BURNING_S = 0.3
BURNS = f"import sys, time; print('begun', flush=True); end = time.process_time() + {BURNING_S}"
THEN_WAITS = f"{BURNS}\nwhile time.process_time() < end: pass\nsys.stdin.read()"


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        ((sys.executable, "-c", service.WORKER), "worker"),
        ((*COMMAND, "7", "load-all"), "simulation"),
        (("/opt/pg/bin/postgres", "-D", "/var/lib/arena"), "database"),
        (("postgres: vitac vitac [local] idle",), "database"),
        (("/usr/bin/bwrap", "--ro-bind", "/state/scratch/worker-1/unpacked", "/submission"), "policy"),
        (("python", "-P", "-I", bubblewrap.INSIDE_RUNTIME, "3", "4"), "policy"),
        (("",), "policy"),
    ],
)
def test_processes_are_told_apart_by_their_command_line(command: tuple[str, ...], kind: str) -> None:
    assert service.name_process("\0".join(command)) == kind


@pytest.fixture
def burning() -> Iterator["subprocess.Popen[bytes]"]:
    """A process that uses some CPU time and waits then; by its command line a worker."""
    command = [sys.executable, "-c", THEN_WAITS, "vitac.worker.main"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process
        process.kill()


def test_cpu_time_counts_for_the_kind_of_the_process_that_used_it_and_once(
    burning: "subprocess.Popen[bytes]",
) -> None:
    eventually(lambda: process_tree.cpu_s(burning.pid) > BURNING_S)
    times = service.cpu_by_kind()
    assert times["worker"] > BURNING_S
    assert times["benchmark"] == pytest.approx(time.process_time(), abs=1.0)
    used = service.since(times)
    assert used["worker"] < BURNING_S
    assert "simulation" not in used


@pytest.mark.parametrize(
    ("waits_ms", "summary"),
    [
        ([], {"n": 0}),
        ([7.0], {"n": 1, "median": 7.0, "p95": 7.0, "longest": 7.0}),
        ([30.0, 10.0, 20.0], {"n": 3, "median": 20.0, "p95": 30.0, "longest": 30.0}),
    ],
)
def test_any_number_of_waits_can_be_measured(waits_ms: list[float], summary: dict[str, float]) -> None:
    assert service.summarize(waits_ms) == summary
