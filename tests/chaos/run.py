"""Disturbs a whole service for a while, and looks whether anything was lost, doubled, changed or left behind.

    .venv/bin/python tests/chaos/run.py --submissions 1000 --minutes 30

The seed of the faults is printed and can be given. Exit code 0: nothing was found.
"""

import argparse
import contextlib
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).resolve().parents[1] / "support" / name) for name in ("infrastructure", "service")]

import httpx
import psycopg
from disturbed_service import VITAC, DisturbedService, command_of
from faults import Faults
from many_submissions import EPISODES, KINDS, ManySubmissions, archive
from small_disk import mount_small_disk

DISK_BYTES = 1536 << 20
CUT_PART = 30
"""A cut of the database's connections takes this part of the run, and at most a minute."""

NOTHING_MORE_S = 300.0
"""In calm, an evaluation ends at least this often, or something hangs [s]."""

CALM_SHARE = 0.7
"""After so many of the faults the next one waits until a worker is ready again."""

WHOLE_LIMIT_S = 120.0
"""After the last fault, server and workers may take so long to be back."""

WORKER_LIMIT_S = 60.0
LOST_SHARD_LIMIT_S = 60.0
"""The shard of a killed worker is waited for at least so long, to tell how long it took."""

LAST_EVENTS = 20
"""So many lines of each log are printed when something was found."""

END_LIMIT_S = 60.0
"""Processes of what was killed may take so long to end once the service has ended."""

READY = "SELECT pid FROM workers WHERE state = 'ready' AND heartbeat_at > now() - interval '4 seconds'"

FINDINGS = """
    SELECT submissions.id::text, submissions.name, evaluations.state, evaluations.result_hash,
           coalesce(evaluations.verdict_message, ''), evaluations.run
    FROM submissions LEFT JOIN evaluations ON evaluations.submission_id = submissions.id
"""


def main() -> int:
    options = parse()
    print(f"seed {options.seed}", flush=True)
    folder = Path(tempfile.mkdtemp(prefix="vitac-chaos-"))
    folder.chmod(0o711)
    problems = ["the run was interrupted"]
    try:
        with state_disk(folder) as has_small_disk:
            problems = disturb(DisturbedService(folder=folder, workers=options.workers), options, has_small_disk)
    finally:
        leave(folder, problems)
    return 1 if problems else 0


def leave(folder: Path, problems: Sequence[str]) -> None:
    """Print what was found; the folder goes where that is nothing."""
    if problems:
        print_last_events(folder)
    else:
        shutil.rmtree(folder)
    for problem in problems:
        print(f"FOUND {problem}")
    print("found nothing" if not problems else f"the service events are in {folder}")


def print_last_events(folder: Path) -> None:
    """Print how the logs of the service's processes end: where CI ran, nobody can look into the folder."""
    for log in sorted(folder.glob("*.log")):
        print(f"--- {log.name}")
        for line in log.read_text(errors="replace").splitlines()[-LAST_EVENTS:]:
            print(line[:400])


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--submissions", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=30.0, help="how long it is disturbed at most")
    lost = "how long the shard of a killed worker may wait for another one [s]; give more on a busy machine"
    parser.add_argument("--lost-shard-s", type=float, default=10.0, help=lost)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(1 << 32))
    return parser.parse_args()


@contextmanager
def state_disk(folder: Path) -> Iterator[bool]:
    """A disk for the state directory that can be filled; without the right to mount one, its own folder."""
    state_dir = folder / "state"
    state_dir.mkdir(mode=0o711)
    if not mount_small_disk(state_dir, DISK_BYTES):
        print("no disk can be mounted here: the fault of a full disk is left out")
        yield False
        return
    try:
        yield True
    finally:
        subprocess.run(["umount", "--lazy", str(state_dir)], check=True)


def disturb(service: DisturbedService, options: argparse.Namespace, has_small_disk: bool) -> list[str]:
    """Run everything and return what was found."""
    faults = Faults(
        service=service,
        random=random.Random(options.seed),
        has_small_disk=has_small_disk,
        cut_s=min(60.0, 60.0 * options.minutes / CUT_PART),
        lost_shard_limit_s=max(LOST_SHARD_LIMIT_S, options.lost_shard_s),
    )
    expected = [expected_hash(service, kind) for kind in range(KINDS)]
    submissions = ManySubmissions(address=service.address, count=options.submissions)
    service.start()
    try:
        wait_until_ready(service)
        submissions.register_teams()
        submissions.start()
        began = time.monotonic()
        done = make_faults(faults, until=began + 60.0 * options.minutes, count=options.submissions)
        ended = wait_for_all(service, options.submissions)
        submissions.stop()
        print(f"{options.submissions} submissions, {done} faults, {time.monotonic() - began:.0f} s")
        print(f"answers and errors that led to another try: {submissions.refusals}")
        print(f"seconds until a killed worker's shard ran elsewhere: {[round(s, 1) for s in faults.lost_shard_s]}")
        problems = [] if ended else ["evaluations stopped ending"]
        problems += [] if done else ["nothing was disturbed: give more submissions"]
        problems += [] if is_whole_again(service) else [f"server and workers were not back within {WHOLE_LIMIT_S:g} s"]
        problems += compare(service, submissions, expected)
        problems += [f"answer {text}" for text in submissions.unexpected]
        problems += [f"a lost shard waited {s:.1f} s" for s in faults.lost_shard_s if s > options.lost_shard_s]
    finally:
        service.stop()
    return problems + lasting_traces(service)


def expected_hash(service: DisturbedService, kind: int) -> str:
    """What `vitac evaluate` gives for a policy of that kind."""
    path = service.folder / "expected.zip"
    path.write_bytes(archive(kind))
    result = service.folder / "expected.json"
    command = [sys.executable, "-c", VITAC, "evaluate", str(path), "--workers", "1", "--json", str(result)]
    subprocess.run(command, env=service.environment | {"TMPDIR": str(service.folder)}, check=True, capture_output=True)
    found: str = json.loads(result.read_text())["result_hash"]
    path.unlink()
    result.unlink()
    return found


def wait_until_ready(service: DisturbedService, limit_s: float = 300.0) -> None:
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        with contextlib.suppress(httpx.HTTPError):
            if httpx.get(f"{service.address}/ready", timeout=10).is_success:
                return
        time.sleep(0.2)
    raise TimeoutError(f"the service was not ready within {limit_s:g} s")


def make_faults(faults: Faults, *, until: float, count: int) -> int:
    """Disturb until the time is over or everything has ended; return how often."""
    done = 0
    while True:
        for fault in faults.all():
            if time.monotonic() > until or count_ended(faults.service) == count:
                return done
            print(f"{until - time.monotonic():6.0f} s left: {fault()}", flush=True)
            done += 1
            time.sleep(faults.random.uniform(1.0, 5.0))
            if faults.random.random() < CALM_SHARE:
                wait_for_worker(faults.service)


def wait_for_worker(service: DisturbedService) -> None:
    """Wait until a worker takes shards, so that faults also meet a service at work; a minute at most."""
    deadline = time.monotonic() + WORKER_LIMIT_S
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, psycopg.Error):
            if service.query(READY):
                return
        time.sleep(0.2)


def is_whole_again(service: DisturbedService) -> bool:
    """Return whether all workers come back: each sweeps first what those that were killed have left."""
    deadline = time.monotonic() + WHOLE_LIMIT_S
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, psycopg.Error, httpx.HTTPError):
            ready = {row[0] for row in service.query(READY)} - service.ended
            answers = httpx.get(f"{service.address}/ready", timeout=10).is_success
            if answers and ready >= {service.pid(name) for name in service.worker_names}:
                return True
        time.sleep(0.2)
    return False


def count_ended(service: DisturbedService) -> int | None:
    try:
        return int(service.query("SELECT count(*) FROM evaluations WHERE finished_at IS NOT NULL")[0][0])
    except (OSError, psycopg.Error):
        return None


def wait_for_all(service: DisturbedService, count: int) -> bool:
    """Wait in calm until every evaluation has ended; return False when none has for a long time."""
    best, changed = -1, time.monotonic()
    while best < count:
        ended = count_ended(service) or 0
        if ended > best:
            best, changed = ended, time.monotonic()
        if time.monotonic() - changed > NOTHING_MORE_S:
            return False
        time.sleep(0.5)
    return True


def compare(service: DisturbedService, submissions: ManySubmissions, expected: list[str]) -> list[str]:
    """Return what is lost, doubled or different."""
    problems = []
    rows: dict[str, list[tuple[Any, ...]]] = {}
    for row in service.query(FINDINGS):
        rows.setdefault(row[0], []).append(row)
    if len(submissions.accepted) != submissions.count or len(set(submissions.accepted.values())) != submissions.count:
        problems.append(f"{len(submissions.accepted)} of {submissions.count} submissions were accepted")
    problems += [f"submission {lost} is lost" for lost in set(submissions.accepted.values()) - set(rows)]
    problems += [f"submission {added} was never sent" for added in set(rows) - set(submissions.accepted.values())]
    for evaluations in rows.values():
        name, state, result_hash, message, run = evaluations[0][1:]
        kind = int(name.removeprefix("short ")) % KINDS
        if len(evaluations) != 1 or run != 1:
            problems.append(f"{name} was evaluated {len(evaluations)} times, run {run}")
        if state != "completed" or result_hash != expected[kind]:
            problems.append(f"{name} is {state} with hash {result_hash}, expected {expected[kind]}. {message}")
    episodes = service.query("SELECT count(*) FROM episode_results")[0][0]
    if episodes != EPISODES * submissions.count:
        problems.append(f"{episodes} episodes are stored, expected {EPISODES * submissions.count}")
    differences = service.query("SELECT count(*) FROM episode_differences")[0][0]
    return problems + ([f"{differences} episodes differed when they were played again"] if differences else [])


def lasting_traces(service: DisturbedService) -> list[str]:
    """Return what a service that has ended left behind for good."""
    deadline = time.monotonic() + END_LIMIT_S
    while (found := traces(service)) and time.monotonic() < deadline:
        time.sleep(0.5)
    return found


def traces(service: DisturbedService) -> list[str]:
    """Return what is there of it: processes, sockets, folders."""
    problems = [f"process {pid} still runs: {command_of(pid)!r}" for pid in service.pids()]
    places = (service.temporary_dir, service.state_dir / "scratch", service.state_dir / "postgres/cluster/socket")
    problems += [f"{path} is left" for place in places for path in place.iterdir()]
    staged = [path for path in (service.state_dir / "blobs").rglob("*") if path.is_file() and "#" in path.name]
    return problems + [f"{path} is half an upload" for path in staged]


if __name__ == "__main__":
    sys.exit(main())
