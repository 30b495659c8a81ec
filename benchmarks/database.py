"""What one PostgreSQL carries: claims and episodes per second, idle workers, and a scrape of `/metrics`.

Run it as `python benchmarks/database.py [--shards 18000] [--clients 8] [--json FILE]`. It starts a database of its own,
which syncs its files as in production, fills its queue, and lets processes claim shards and store episodes without
simulating any. Rates by the clock depend on what else the machine does; the CPU time of PostgreSQL for each operation
hardly does, and says what a core of a database server carries.
"""

import argparse
import json
import multiprocessing
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from uuid import UUID, uuid4

import numpy as np
from boards import make_statistics
from sqlalchemy import text
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord, Timings
from vitac.evaluator.tracks import load_track
from vitac.evaluator.version import evaluator_version, platform_class
from vitac.server.database.engine import Database
from vitac.server.database.metrics import Instruments, TotalsWriter
from vitac.server.database.models import Worker
from vitac.server.database.states import WorkerState
from vitac.server.evaluations.episode_store import store_episodes
from vitac.server.evaluations.lifecycle import give_up
from vitac.server.operations.exposition import Exposition
from vitac.server.queue import leases, workers
from vitac.server.queue.work import claim, name_requirement, sweep
from vitac.server.services import Services, open_services
from vitac.server.settings import Settings, load_settings
from vitac.worker.worker import POLL_S

TRACK, TASK = "track_1", "peg-insertion"
EPISODES_OF_SHARD = 30
ENV_STEPS = 5
INFO_BYTES = 1200
"""Of one env step: a record has 7 KB then, where those of the peg task have 4.5 and those of longer episodes more."""
LEASE_S = 3600.0
IDLE_ROUNDS = 200
SHARDS_OF_ONE = 9

TEAMS = "INSERT INTO teams (id, name, name_key) VALUES (gen_random_uuid(), 'benchmark', 'benchmark')"
SUBMISSIONS = """
    INSERT INTO submissions (id, team_id, kind, track, tasks, name, digest, archive_sha256, archive_bytes, manifest)
    SELECT gen_random_uuid(), teams.id, 'model', 'track_1', ARRAY['peg-insertion'], 'zero',
           encode(sha256(number::text::bytea), 'hex'), encode(sha256(number::text::bytea), 'hex'), 1, '{}'
    FROM teams, generate_series(1, :submissions) number
"""
EVALUATIONS = """
    INSERT INTO evaluations
        (id, submission_id, run, evaluator_version, evaluator_hash, state, episodes_reused, log_tail, list_kind)
    SELECT gen_random_uuid(), id, 1, :version, repeat('0', 64), 'queued', 0, '', 'public' FROM submissions
"""
SHARDS = """
    WITH cut AS (
        SELECT id AS evaluation, number, row_number() OVER () AS place
        FROM evaluations, generate_series(1, :shards) number WHERE state = 'queued'
    ), added AS (
        INSERT INTO work (kind, owner, requires, priority, queued_at)
        SELECT 'shard', 'benchmark', :requires, 5, now() - interval '1 day' FROM cut RETURNING id
    )
    INSERT INTO shards (id, evaluation_id, task, number, episodes)
    SELECT added.id, evaluation, 'peg-insertion', number, ARRAY[number]
    FROM (SELECT id, row_number() OVER () AS place FROM added) added JOIN cut USING (place)
"""
SCRAPES = 20


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shards", type=int, default=18_000, help="how many wait")
    parser.add_argument("--clients", type=int, default=8, help="processes that claim and store at the same time")
    parser.add_argument("--claims", type=int, default=4000, help="how many shards are claimed")
    parser.add_argument("--episodes", type=int, default=12_000, help="how many episodes are stored")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    with service(arguments.shards) as services:
        figures = {
            "shards_queued": arguments.shards,
            "clients": arguments.clients,
            "processors": os.cpu_count(),
            "scrape": scrape_figures(services),
            "claims": claim_figures(services, arguments.clients, arguments.claims),
            "episodes": episode_figures(services, arguments.clients, arguments.episodes),
            "idle": idle_figures(services),
        }
    content = json.dumps(figures, indent=1)
    print(content)
    if arguments.json:
        arguments.json.write_text(content + "\n")


@contextmanager
def service(n_shards: int) -> Iterator[Services]:
    """Open services whose queue is that long."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-benchmark-"))
    folder.chmod(0o711)
    try:
        with open_services(load_settings(state_dir=folder / "state", database_url=None)) as services:
            with services.database.transaction() as session:
                fill(session, n_shards)
            make_statistics(services)
            yield services
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def fill(session: Session, n_shards: int) -> None:
    """Make the rows of evaluations with nine shards each, which wait."""
    values = {
        "submissions": -(-n_shards // SHARDS_OF_ONE),
        "shards": SHARDS_OF_ONE,
        "version": evaluator_version(),
        "requires": name_requirement(evaluator_version()),
    }
    for statement in (TEAMS, SUBMISSIONS, EVALUATIONS, SHARDS):
        session.execute(text(statement), {name: value for name, value in values.items() if f":{name}" in statement})


def scrape_figures(services: Services) -> dict[str, float]:
    """Return what an answer to Prometheus costs with this queue, each time read again [ms]."""
    exposition = Exposition(services, clock=iter(range(0, 1 << 30, 60)).__next__)  # every answer is too old to be kept
    exposition.text()
    with postgres_time(services) as postgres:
        began = perf_counter()
        for _ in range(SCRAPES):
            exposition.text()
        wall_s = perf_counter() - began
    return {"wall_ms": round(1000 * wall_s / SCRAPES, 2), "postgres_cpu_ms": postgres.ms_of_one(SCRAPES)}


def claim_figures(services: Services, n_clients: int, count: int) -> dict[str, float]:
    """Return rate and cost of claims."""
    with postgres_time(services) as postgres:
        wall_s = run_in_processes(partial(claim_next, services.database.address), share_out(range(count), n_clients))
    return {"per_s": round(count / wall_s, 1), "postgres_cpu_ms": postgres.ms_of_one(count)}


def claim_next(address: str, places: Sequence[int]) -> None:
    """Claim so many shards and begin them, as a worker does; runs in a process of its own."""
    database = Database(address)
    settings, worker_id = load_settings(database_url=address, lease_s=LEASE_S), uuid4()
    for _ in places:
        begin_next(database, settings, worker_id)
    database.dispose()


def begin_next(database: Database, settings: Settings, worker_id: UUID) -> leases.Lease:
    """Take the next shard and begin it."""
    claimed = claim(database, settings, worker_id, [name_requirement(evaluator_version())])
    if claimed is None:
        raise SystemExit("No shard waits.")
    with database.transaction() as session:
        return leases.begin(session, claimed)


def episode_figures(services: Services, n_clients: int, count: int) -> dict[str, float]:
    """Return rate, cost and size of stored episodes."""
    with services.database.transaction() as session:
        bytes_before = session.scalar(text("SELECT pg_total_relation_size('episode_results')")) or 0
        wal_before = session.scalar(text("SELECT pg_current_wal_lsn()"))
    n_shards = count // EPISODES_OF_SHARD
    n_episodes = n_shards * EPISODES_OF_SHARD
    with postgres_time(services) as postgres:
        wall_s = run_in_processes(partial(store_all, services.database.address), share_out(range(n_shards), n_clients))
    with services.database.transaction() as session:
        n_bytes = (session.scalar(text("SELECT pg_total_relation_size('episode_results')")) or 0) - bytes_before
        wal = session.scalar(text("SELECT pg_current_wal_lsn() - CAST(:before AS pg_lsn)"), {"before": wal_before})
    return {
        "per_s": round(n_episodes / wall_s, 1),
        "postgres_cpu_ms": postgres.ms_of_one(n_episodes),
        "stored_bytes": round(n_bytes / n_episodes),
        "written_ahead_bytes": round(float(wal or 0) / n_episodes),
    }


def store_all(address: str, places: Sequence[int]) -> None:
    """Claim shards and store the episodes of each; runs in a process of its own.

    Each episode has a transaction of its own, which costs more than the half second that a worker stores together.
    """
    database = Database(address)
    records = [a_record(episode) for episode in range(1, EPISODES_OF_SHARD + 1)]
    settings = load_settings(database_url=address, lease_s=LEASE_S)
    for _ in places:
        lease = begin_next(database, settings, uuid4())
        own = replace(lease, submission_digest=f"{lease.work_id:064x}")  # no episode is stored already
        for record in records:
            with database.transaction() as session:
                store_episodes(session, own, [record])
    database.dispose()


def a_record(episode: int) -> EpisodeRecord:
    """Return a record of the size of a real one."""
    listed = load_track(TRACK).tasks[TASK].episodes[episode - 1]
    rng = np.random.default_rng(episode)
    return EpisodeRecord(
        episode=episode, task=TASK, shape=listed.shape, initial_offset=listed.offset, outcome=EpisodeOutcome.SUCCESS,
        env_steps=ENV_STEPS, total_reward=1.0,
        actions=ActionSequence.from_array(rng.uniform(-1, 1, (ENV_STEPS, 3)).astype(np.float32)),
        state_hashes=tuple(rng.bytes(32).hex() for _ in range(ENV_STEPS + 1)),
        infos=tuple({"filling": rng.bytes(INFO_BYTES // 2).hex()} for _ in range(ENV_STEPS)),
        timings=Timings(wall_s=0.1),
    )  # fmt: skip


def idle_figures(services: Services) -> dict[str, float]:
    """Return what one process of each kind costs PostgreSQL while nothing happens, per second [ms]."""
    settings, database = services.settings, services.database
    worker_id = register(database)
    disk = workers.measure_disk(settings.scratch_dir)
    totals = TotalsWriter(Instruments())
    totals.write(database)

    def heartbeat() -> None:
        with database.transaction() as session:
            workers.heartbeat(session, worker_id, WorkerState.READY, disk)

    def poll() -> None:
        claim(database, settings, worker_id, ["nothing that waits"])

    def housekeeping() -> None:
        with database.transaction() as session:
            sweep(session, settings, give_up=give_up)
        totals.write(database)

    return {
        "heartbeats_cpu_ms_per_s": measure_cost(services, heartbeat) / settings.worker_heartbeat_s,
        "housekeeping_cpu_ms_per_s": measure_cost(services, housekeeping) / settings.sweep_interval_s,
        "polling_cpu_ms_per_s": measure_cost(services, poll) / POLL_S,
    }


def register(database: Database) -> UUID:
    """Add a worker's row."""
    row = Worker(
        id=uuid4(), host="benchmark", pid=os.getpid(), slots=1, state=WorkerState.READY,
        evaluator_version=evaluator_version(), platform_class=platform_class(), isolation="none",
    )  # fmt: skip
    with database.transaction() as session:
        workers.register(session, row)
    return row.id


def measure_cost(services: Services, work: Callable[[], None]) -> float:
    """Return the CPU time of PostgreSQL for one call [ms]."""
    with postgres_time(services) as postgres:
        for _ in range(IDLE_ROUNDS):
            work()
    return postgres.ms_of_one(IDLE_ROUNDS)


def share_out(ids: Sequence[int], n_clients: int) -> list[Sequence[int]]:
    """Give each client every n-th one."""
    return [ids[first::n_clients] for first in range(n_clients)]


def run_in_processes(work: Callable[[Sequence[int]], None], parts: Sequence[Sequence[int]]) -> float:
    """Run the work on each part in a process of its own; return the wall time after all are there [s]."""
    with multiprocessing.get_context("spawn").Pool(len(parts)) as pool:
        pool.map(_nothing, range(len(parts)), chunksize=1)
        began = perf_counter()
        pool.map(work, parts, chunksize=1)
        return perf_counter() - began


def _nothing(_number: int) -> None:
    """Have the process import this module."""


class PostgresTime:
    """CPU time of PostgreSQL and all its processes between two moments."""

    def __init__(self, postmaster: int) -> None:
        self._postmaster = postmaster
        self._began_s = self._total_s()
        self._spent_s = 0.0

    def end(self) -> None:
        """Take the second moment."""
        self._spent_s = self._total_s() - self._began_s

    def ms_of_one(self, count: int) -> float:
        """Return the time of one operation, given how many there were [ms]."""
        return round(1000 * self._spent_s / count, 3)

    def _total_s(self) -> float:
        """Return the time of the postmaster, of its children, and of those that have ended."""
        total = 0
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(") ")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            pid, parent = int(stat.parent.name), int(fields[1])
            if pid == self._postmaster:
                total += sum(map(int, fields[11:15]))
            elif parent == self._postmaster:
                total += sum(map(int, fields[11:13]))
        return total / os.sysconf("SC_CLK_TCK")


@contextmanager
def postgres_time(services: Services) -> Iterator[PostgresTime]:
    """Measure the CPU time of PostgreSQL while the block runs."""
    if services.postgres is None or services.postgres.server_pid is None:
        raise SystemExit("The database has to be the embedded one of this process.")
    measured = PostgresTime(services.postgres.server_pid)
    yield measured
    measured.end()


if __name__ == "__main__":
    main()
