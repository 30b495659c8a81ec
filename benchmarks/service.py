"""Measures the service: whole evaluations of the example policies by parts, and the wait in the queue.

Run it as `python benchmarks/service.py [--workers 1] [--slots 2] [--waits 20] [--json FILE]` on an otherwise idle
machine. It starts a database and workers of its own in a temporary folder, as `vitac serve` does, and waits until they
have loaded the simulation. One worker with a slot for each processor is what `vitac demo` starts and docs/capacity.md
advises. `cpu_s` says where the CPU time of an evaluation went, by kind of process; unlike its wall time it can be
compared on a machine that does other work, except that `at_rest_s_per_s` covers the time that it takes. `slots_s`
says how long the slots, all together, played no episode.
"""

import argparse
import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session
from vitac.evaluator.agent.isolation.process_tree import cpu_s, descendants, read_text_file, reaped_cpu_s
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.scoring.score import score
from vitac.evaluator.shards.process import IDLE_KEPT_S
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts import teams
from vitac.server.database.models import Evaluation, Shard, Work, Worker
from vitac.server.database.states import TERMINAL_EVALUATION_STATES, EvaluationState, Role
from vitac.server.evaluations.episode_store import EpisodeKey, read_stored_records, store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.operations.housekeeping import Housekeeping
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import leases, work, workers
from vitac.server.services import Services, open_services
from vitac.server.settings import load_settings
from vitac.server.submissions import creation, listing, runs
from vitac.server.submissions.intake import ReceivedFile
from vitac.server.submissions.kinds import accept
from vitac.worker.shard_run import TOGETHER_S

EXAMPLES = Path(__file__).parents[1] / "examples"
PEG_INSERTION = EXAMPLES / "peg_insertion_heuristic" / "Track_1"
LOCK_OPENING = EXAMPLES / "lock_opening_heuristic" / "Track_1"
OURS = "the benchmark"
WORKER = "from vitac.server.settings import load_settings; from vitac.worker.main import run; run(load_settings())"
POLL_S = 0.05
LONG_POLL_S = 0.5
"""While an evaluation runs, so that asking how far it is takes little of what is measured."""
LOADING_S = 5.0
"""Workers load the simulation after they are ready; nothing tells when they have."""
LIMIT_S = 3600.0
AT_REST_S = 5.0
"""So long the service is watched without an evaluation."""
SANDBOXES_END_S = IDLE_KEPT_S + 1.0
"""After so long those of the last evaluation have ended: what they used then counts as that of the simulation."""
KINDS = {"vitac.evaluator.shards.host": "simulation", "vitac.worker.main": "worker", "postgres": "database"}
"""What a process is, by a part of its command line; a process of ours that has none of them belongs to a sandbox."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=1, help="worker processes")
    parser.add_argument(
        "--slots", type=int, default=len(os.sched_getaffinity(0)), help="shards that each plays at once"
    )
    parser.add_argument("--waits", type=int, default=20, help="how many waits in the queue are measured")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    n_slots = arguments.workers * arguments.slots
    with service(arguments.workers, arguments.slots) as (services, principal):
        time.sleep(LOADING_S)
        figures = {
            "evaluation": {
                "peg-insertion": evaluation_figures(services, principal, PEG_INSERTION, n_slots),
                "lock-opening": evaluation_figures(services, principal, LOCK_OPENING, n_slots),
            },
            "at_rest_s_per_s": measure_at_rest(),
            "enqueue_to_start_ms": wait_figures(services, principal, arguments.waits),
        }
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


@contextmanager
def service(n_workers: int, slots: int) -> Iterator[tuple[Services, Principal]]:
    """Open services with a team and ready workers, each with the given number of slots."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-benchmark-"))
    folder.chmod(0o711)
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        services = stack.enter_context(open_services(load_settings(state_dir=folder / "state", database_url=None)))
        housekeeping = Housekeeping(services)
        housekeeping.start()
        stack.callback(housekeeping.stop)
        variables = {"VITAC_STATE_DIR": str(services.settings.state_dir), "VITAC_WORKER_SLOTS": str(slots)}
        for _ in range(n_workers):
            process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-c", WORKER], env=os.environ | variables
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
        wait_until(lambda: count_workers(services) == n_workers)
        with services.database.transaction() as session:
            team = teams.register(session, CONSOLE, name="benchmark")
        yield services, Principal(role=Role.TEAM, team_id=team.id, team_name=team.name)


def evaluation_figures(services: Services, principal: Principal, example: Path, n_slots: int) -> dict[str, Any]:
    """Return the wall time of all episodes of an example policy, and its parts [s]."""
    time.sleep(SANDBOXES_END_S)
    submission_id = upload(services, principal, example)
    before_s = cpu_by_kind()
    wait_until(lambda: newest(services, submission_id).state in TERMINAL_EVALUATION_STATES, LONG_POLL_S)
    used_s = since(before_s)
    done = newest(services, submission_id)
    if done.state is not EvaluationState.COMPLETED or done.started_at is None or done.finished_at is None:
        raise SystemExit(f"The evaluation ended as {done.state}: {done.verdict_code} {done.verdict_message}")
    with services.database.transaction() as session:
        task = done.submission.tasks[0]
        records = read_stored_records(session, EpisodeKey.from_evaluation(done, done.submission), task)
        machines = list(session.scalars(select(Worker.platform_class).distinct()))
        idle_at_end_s = idle_after_last_start_s(session, done, n_slots)
    wall_s = (done.finished_at - done.started_at).total_seconds()
    sums = parts(services, records)
    return {
        "episodes": len(records),
        "slots": n_slots,
        "processors": os.cpu_count(),
        "platform_class": machines,
        "wall_s": round(wall_s, 2),
        "cpu_s": used_s,
        "slots_s": {
            "outside_episodes": round(n_slots * wall_s - sums["wall_s"], 2),
            "of_it_without_a_shard_at_the_end": round(idle_at_end_s, 2),
        },
        "wall_over_physics": round(wall_s * min(n_slots, os.cpu_count() or 1) / sums["physics_s"], 2),
        "success_rate": score(records).success_rate,
        "result_hash": done.result_hash,
        "seconds_of_all_episodes": sums,
    }


def idle_after_last_start_s(session: Session, evaluation: Evaluation, n_slots: int) -> float:
    """Return how long the slots, all together, had no shard any more when the last one was at work [s]."""
    query = select(Shard.started_at, Shard.finished_at).where(Shard.evaluation_id == evaluation.id)
    times = [(start, end) for start, end in session.execute(query) if start is not None and end is not None]
    last_start = max(start for start, _ in times)
    end = max(end for _, end in times)
    at_work_s = sum((end - max(start, last_start)).total_seconds() for start, end in times if end > last_start)
    return n_slots * (end - last_start).total_seconds() - at_work_s


def cpu_by_kind() -> dict[str, float]:
    """Return the CPU time so far of this process and of all below it, by what they are [s]."""
    times = {"benchmark": time.process_time()}
    for pid in descendants(os.getpid()):
        with suppress(OSError):  # it has ended meanwhile
            kind = name_process(read_text_file(f"/proc/{pid}/cmdline"))
            times[kind] = times.get(kind, 0.0) + cpu_s(pid) + reaped_cpu_s(pid)
    return times


def name_process(command: str) -> str:
    """Return what a process is, by its command line."""
    return next((kind for part, kind in KINDS.items() if part in command), "policy")


def since(before_s: dict[str, float]) -> dict[str, float]:
    """Return the CPU time used since then, by kind of process [s]."""
    return {kind: round(now_s - before_s.get(kind, 0.0), 2) for kind, now_s in sorted(cpu_by_kind().items())}


def measure_at_rest() -> dict[str, float]:
    """Return the CPU time that the service uses without an evaluation, by kind of process [s/s]."""
    time.sleep(SANDBOXES_END_S)
    before_s = cpu_by_kind()
    time.sleep(AT_REST_S)
    return {kind: round(used_s / AT_REST_S, 4) for kind, used_s in since(before_s).items()}


def parts(services: Services, records: Sequence[EpisodeRecord]) -> dict[str, float]:
    """Return sums over the episodes [s]; `database_s` is measured by storing the same records again."""
    names = ("physics_s", "markers_s", "policy_s", "channel_s", "wall_s")
    sums = {name: sum(getattr(record.timings, name) for record in records) for name in names}
    sums["database_s"] = storing_s(services, records)
    return {name: round(value, 3) for name, value in sums.items()}


def storing_s(services: Services, records: Sequence[EpisodeRecord]) -> float:
    """Return the time to store the records of a further run, in as many transactions as workers need [s]."""
    with services.database.transaction() as session:
        submission = listing.list_submissions(session, services.settings, CONSOLE).items[0]
        again = runs.run_again(session, CONSOLE, submission.id)
        evaluation = newest_evaluation(session, again)
        shards = {episode: shard.id for shard in evaluation.shards for episode in shard.episodes}
        session.execute(update(Work).where(Work.id.in_(shards.values())).values(requires=OURS))  # no worker takes them
    held = {lease.work_id: lease for lease in (claim_next(services) for _ in set(shards.values()))}
    started = time.perf_counter()
    for together in stored_together(records, shards):
        with services.database.transaction() as session:
            store_episodes(session, held[shards[together[0].episode]], together)
    took_s = time.perf_counter() - started
    with services.database.transaction() as session:
        runs.cancel(session, CONSOLE, submission.id)
    return took_s


def stored_together(records: Sequence[EpisodeRecord], shards: dict[int, int]) -> Iterator[list[EpisodeRecord]]:
    """Yield the records that come from a shard within the time for which workers wait for more."""
    for _, of_shard in groupby(records, key=lambda record: shards[record.episode]):
        together: list[EpisodeRecord] = []
        for record in of_shard:
            together.append(record)
            if sum(each.timings.wall_s for each in together) > TOGETHER_S:
                yield together
                together = []
        if together:
            yield together


def claim_next(services: Services) -> leases.Lease:
    """Take a shard for the benchmark itself."""
    settings = services.settings.model_copy(update={"lease_s": LIMIT_S})
    claimed = work.claim(services.database, settings, uuid4(), [OURS])
    if claimed is None:
        raise SystemExit("A worker has taken a shard of the benchmark.")
    with services.database.transaction() as session:
        return leases.begin(session, claimed)


def wait_figures(services: Services, principal: Principal, n: int) -> dict[str, float]:
    """Return the times from a submission's commit to the claim of its first shard by an idle worker [ms]."""
    waits_ms = []
    for number in range(n):
        submission_id = upload(services, principal, PEG_INSERTION, note=f"# {number}\n")
        waits_ms.append(1000 * started_after_s(services, submission_id))
        with services.database.transaction() as session:
            runs.cancel(session, principal, submission_id)
        wait_until(lambda: not running_shards(services))
        time.sleep(2 * services.settings.lease_renewal_s)
    return summarize(waits_ms)


def summarize(waits_ms: Sequence[float]) -> dict[str, float]:
    """Return how many waits there were and, if any, how long they are [ms]."""
    n = len(waits_ms)
    if not n:
        return {"n": 0}
    in_order = sorted(waits_ms)
    return {
        "n": n,
        "median": round(statistics.median(in_order), 1),
        "p95": round(in_order[min(n - 1, int(0.95 * n))], 1),
        "longest": round(in_order[-1], 1),
    }


def started_after_s(services: Services, submission_id: UUID) -> float:
    """Wait for a worker to start a submission and return how long that took [s]."""
    wait_until(lambda: newest(services, submission_id).started_at is not None)
    begun = newest(services, submission_id)
    return (begun.started_at - begun.created_at).total_seconds() if begun.started_at else float("nan")


def upload(services: Services, principal: Principal, example: Path, note: str = "") -> UUID:
    """Submit an example policy, with a note that changes its digest, and return its id."""
    with tempfile.TemporaryDirectory(dir=services.settings.scratch_dir) as name:
        folder = Path(name) / "packed" / "Track_1"
        shutil.copytree(example, folder)
        (folder / "note.txt").write_text(note)
        archive = Path(shutil.make_archive(str(Path(name) / "archive"), "zip", folder.parent))
        content = archive.read_bytes()
        received = ReceivedFile(path=archive, sha256=hashlib.sha256(content).hexdigest(), n_bytes=len(content))
        checked = accept(services, received, kind=SubmissionKind.MODEL, track=None, owner="benchmark")
    with services.database.transaction() as session:
        submission, _ = creation.create(session, principal, checked)
        return submission.id


def newest(services: Services, submission_id: UUID) -> Evaluation:
    """Return the newest evaluation of a submission."""
    with services.database.transaction() as session:
        query = select(Evaluation).where(Evaluation.submission_id == submission_id)
        found = session.scalars(query.order_by(Evaluation.created_at.desc())).first()
        if found is None:
            raise SystemExit(f"Submission {submission_id} has no evaluation.")
        _ = found.submission
        return found


def running_shards(services: Services) -> int:
    """Return the number of shards that workers hold."""
    with services.database.transaction() as session:
        query = select(func.count()).select_from(Shard).where(Shard.lease_expires_at.is_not(None))
        return session.scalar(query) or 0


def count_workers(services: Services) -> int:
    """Return the number of ready workers."""
    with services.database.transaction() as session:
        return workers.workers_alive(session, services.settings).alive


def wait_until(holds: Callable[[], bool], poll_s: float = POLL_S) -> None:
    """Wait until a condition is true."""
    deadline = time.monotonic() + LIMIT_S
    while not holds():
        if time.monotonic() > deadline:
            raise SystemExit("The service did not get there within an hour.")
        time.sleep(poll_s)


if __name__ == "__main__":
    main()
