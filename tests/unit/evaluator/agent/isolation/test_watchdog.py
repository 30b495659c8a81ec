import subprocess
import sys
from collections.abc import Iterator

import pytest
from vitac.evaluator.agent.isolation import process_tree
from vitac.evaluator.agent.isolation.sandbox import MemoryWatchdog

MEGABYTE = 1 << 20
SHARES_WITH_CHILDREN = f"""
import os, time
kept = bytearray(os.urandom({MEGABYTE})) * 40
for _ in range(5):
    if os.fork() == 0:
        time.sleep(60)
print(flush=True)
time.sleep(60)
"""


@pytest.fixture
def first() -> Iterator[int]:
    """A first process whose only child shares 40 MB with five children of its own."""
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SHARES_WITH_CHILDREN!r}])"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert len(list(process_tree.descendants(process.pid))) == 6
        yield process.pid
        process_tree.kill_descendants(process.pid)
        process.kill()


def test_shared_pages_are_not_counted_for_everyone(first: int) -> None:
    watchdog = MemoryWatchdog(first, memory_bytes=150 * MEGABYTE)
    pids = list(process_tree.descendants(first))
    assert sum(map(process_tree.resident_bytes, pids)) > 200 * MEGABYTE
    watchdog.look()
    assert watchdog.kills == 0


def test_too_much_memory_ends_every_process(first: int) -> None:
    watchdog = MemoryWatchdog(first, memory_bytes=30 * MEGABYTE)
    watchdog.look()
    assert watchdog.kills == 1
    while any(process_tree.resident_bytes(pid) for pid in process_tree.descendants(first)):
        pass


def test_spared_process_is_neither_counted_nor_ended(first: int) -> None:
    watchdog = MemoryWatchdog(first, memory_bytes=1)
    spared = next(iter(process_tree.descendants(first)))
    watchdog.spared_pid = spared
    watchdog.look()
    assert spared in set(process_tree.descendants(first))


def test_it_stops_with_its_sandbox(first: int) -> None:
    with MemoryWatchdog(first, memory_bytes=1000 * MEGABYTE) as watchdog:
        assert watchdog.kills == 0
