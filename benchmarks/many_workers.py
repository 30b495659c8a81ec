"""Twenty workers on one database that holds 50,000 submissions: claims, boards and submission pages beside them.

Run it as `python benchmarks/many_workers.py [--workers 20] [--submissions 50000] [--seconds 60] [--json FILE]`. Each
worker is a process that claims and begins shards, sends heartbeats and keeps house as a real one, and plays nothing:
first as fast as it can, then with the pause that a shard of 30 peg episodes takes. `claim` and `begin` are what a
worker waits for. Times are wall times on a machine that runs all of it.
"""

import argparse
import asyncio
import json
import multiprocessing
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from multiprocessing.pool import AsyncResult
from pathlib import Path
from typing import Any

import boards
from database import LEASE_S, SHARDS, SHARDS_OF_ONE, postgres_time, register
from sqlalchemy import text
from vitac.evaluator.version import evaluator_version
from vitac.server.database.models import Base
from vitac.server.database.states import WorkerState
from vitac.server.operations.housekeeping import Housekeeping
from vitac.server.queue import leases, work, workers
from vitac.server.queue.work import name_requirement
from vitac.server.services import Services, open_services
from vitac.server.settings import load_settings

N_TEAMS = 200
FIRST = boards.TURNS * N_TEAMS
"""So many submissions are made one by one; the others are copies of them, which the database makes."""
SHARD_S = 1.8
"""For which a worker plays a shard of 30 peg episodes on a core (docs/capacity.md)."""
EVALUATIONS = """
    INSERT INTO evaluations
        (id, submission_id, run, evaluator_version, evaluator_hash, state, episodes_reused, log_tail, list_kind)
    SELECT gen_random_uuid(), id, 2, :version, repeat('0', 64), 'queued', 0, '', 'public'
    FROM submissions WHERE kind = 'model' ORDER BY submitted_at LIMIT :n
"""
COPIED = {
    "submissions": {
        "id": "new_submission",
        "digest": "encode(sha256((digest || n)::bytea), 'hex')",
        "submitted_at": "submitted_at - n * interval '1 hour'",
    },
    "evaluations": {"id": "new_evaluation", "submission_id": "new_submission"},
    "board_results": {"evaluation_id": "new_evaluation", "submission_id": "new_submission"},
}
"""Columns of copies that differ, by table."""
Times = Sequence[tuple[float, float]]
"""Of each claim: of the claim itself, and of beginning its shard [s]."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=20)
    parser.add_argument("--submissions", type=int, default=50_000)
    parser.add_argument("--queued", type=int, default=2000, help="evaluations that wait, of nine shards each")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each part")
    parser.add_argument("--requests", type=int, default=50, help="how many of each page")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    with boards.service(FIRST, N_TEAMS) as services:
        multiply(services, arguments.submissions // FIRST)
        fill(services, arguments.queued)
        figures: dict[str, Any] = {
            "submissions": arguments.submissions,
            "workers": arguments.workers,
            "database_mb": database_mb(services),
            "pages_alone": asyncio.run(boards.measure(services, arguments.requests)),
        }
        print(json.dumps(figures), flush=True)
        with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
            pool.map(nothing, range(arguments.workers), chunksize=1)
            run = partial(together, services, pool, arguments.workers, arguments.seconds)
            figures |= {"as_fast_as_they_can": run(0.0, 0)}
            figures |= {"as_if_they_played": run(SHARD_S, arguments.requests)}
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


def multiply(services: Services, times: int) -> None:
    """Copy all submissions with their evaluations and places on boards."""
    with services.database.transaction() as session:
        session.execute(
            text(
                """
                CREATE TEMPORARY TABLE copies ON COMMIT DROP AS
                SELECT evaluations.id AS evaluation, submission_id AS submission, n,
                       gen_random_uuid() AS new_submission, gen_random_uuid() AS new_evaluation
                FROM evaluations, generate_series(1, :copies) n
                """
            ),
            {"copies": times - 1},
        )
        for table, changed in COPIED.items():
            names = [column.name for column in Base.metadata.tables[table].columns]
            values = ", ".join(changed.get(name, f"{table}.{name}") for name in names)
            key = "submission" if table == "submissions" else "evaluation"
            own = "evaluation_id" if table == "board_results" else "id"
            session.execute(
                text(
                    f"INSERT INTO {table} ({', '.join(names)}) "  # noqa: S608 - our own tables
                    f"SELECT {values} FROM {table} JOIN copies ON copies.{key} = {table}.{own}"
                )
            )


def nothing(_number: int) -> None:
    """Have the process import this module."""


def fill(services: Services, n: int) -> None:
    """Let evaluations wait, and make statistics of all tables."""
    with services.database.transaction() as session:
        session.execute(text(EVALUATIONS), {"n": n, "version": evaluator_version()})
        requires = name_requirement(evaluator_version())
        session.execute(text(SHARDS), {"shards": SHARDS_OF_ONE, "requires": requires})
    boards.make_statistics(services)


def together(
    services: Services, pool: Any, n_workers: int, seconds: float, pause_s: float, n_requests: int
) -> dict[str, Any]:
    """Run all workers, and ask for pages meanwhile if there are requests to make."""
    work = partial(claim_during, services.database.address, seconds, pause_s)
    with postgres_time(services) as postgres:
        found: AsyncResult[list[Times]] = pool.map_async(work, range(n_workers), chunksize=1)
        pages = asyncio.run(boards.measure(services, n_requests)) if n_requests else {}
        claims = [times for one in found.get() for times in one]
    return {
        "claims_per_s": round(len(claims) / seconds, 1),
        "postgres_cores": round(postgres.ms_of_one(1) / 1000 / seconds, 2),
        "claim": boards.percentiles([1000 * claim for claim, _ in claims]),
        "begin": boards.percentiles([1000 * begin for _, begin in claims]),
        "pages": pages,
    }


def claim_during(address: str, seconds: float, pause_s: float, _number: int) -> Times:
    """Be a worker for some seconds; runs in a process of its own."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        settings = load_settings(database_url=address, state_dir=Path(folder))
        services = stack.enter_context(open_services(settings, may_run_database=False))
        housekeeping = Housekeeping(services, supersedes=False)
        housekeeping.start()
        stack.callback(housekeeping.stop)
        return claim_until(services, time.monotonic() + seconds, pause_s)


def claim_until(services: Services, end: float, pause_s: float) -> Times:
    """Claim shards and begin them; return the times of each."""
    times: list[tuple[float, float]] = []
    worker_id, beat_at = register(services.database), 0.0
    settings = services.settings.model_copy(update={"lease_s": LEASE_S})
    while (began := time.monotonic()) < end:
        if began - beat_at > settings.worker_heartbeat_s:
            beat_at = began
            disk = workers.measure_disk(settings.state_dir)
            with services.database.transaction() as session:
                workers.heartbeat(session, worker_id, WorkerState.READY, disk)
        claiming = time.perf_counter()
        claimed = work.claim(services.database, settings, worker_id, [name_requirement(evaluator_version())])
        if claimed is None:
            break
        beginning = time.perf_counter()
        with services.database.transaction() as session:
            leases.begin(session, claimed)
        times.append((beginning - claiming, time.perf_counter() - beginning))
        time.sleep(pause_s)
    return times


def database_mb(services: Services) -> float:
    """Return the size of the database."""
    with services.database.transaction() as session:
        return round((session.scalar(text("SELECT pg_database_size(current_database())")) or 0) / 1e6, 1)


if __name__ == "__main__":
    main()
