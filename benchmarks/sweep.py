"""How long do the sweep for lost shards, withdrawing and forgetting jobs take with a long queue?

Run it as `python benchmarks/sweep.py [--shards 18000] [--repeats 9] [--json FILE]`. It starts a database of its own.
"""

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from time import perf_counter

from sqlalchemy import select, text
from sqlalchemy.orm import Session
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard
from vitac.server.evaluations.lifecycle import fail_by_machines
from vitac.server.queue.jobs import enqueue_shards, forget_jobs_of_ended_shards, queue_name, withdraw_jobs
from vitac.server.queue.sweep import sweep
from vitac.server.services import open_services
from vitac.server.settings import Settings, load_settings

SHARDS_OF_ONE = 9
TARGET_MS = 100.0

TEAMS = "INSERT INTO teams (id, name, name_key) VALUES (gen_random_uuid(), 'benchmark', 'benchmark')"
SUBMISSIONS = """
    INSERT INTO submissions (id, team_id, kind, track, tasks, name, digest, archive_sha256, archive_bytes, manifest)
    SELECT gen_random_uuid(), teams.id, 'model', 'track_1', ARRAY['peg-insertion'], 'zero',
           encode(sha256(number::text::bytea), 'hex'), encode(sha256(number::text::bytea), 'hex'), 1, '{}'
    FROM teams, generate_series(1, :submissions) number
"""
EVALUATIONS = """
    INSERT INTO evaluations
        (id, submission_id, run, evaluator_version, evaluator_hash, state, episodes_reused, log_tail)
    SELECT gen_random_uuid(), id, 1, :version, repeat('0', 64), 'queued', 0, '' FROM submissions
"""
SHARDS = """
    INSERT INTO shards (evaluation_id, task, number, episodes, state, token, attempts, queued_at)
    SELECT id, 'peg-insertion', number, ARRAY[number], 'queued', 0, 0, now() - interval '1 day'
    FROM evaluations, generate_series(1, :shards) number
"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shards", type=int, default=18_000, help="how many wait")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    with queue(arguments.shards) as (database, settings):
        figures = measure(database, settings, arguments.repeats)
    figures |= {"shards": arguments.shards, "target_ms": TARGET_MS}
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


@contextmanager
def queue(n_shards: int) -> Iterator[tuple[Database, Settings]]:
    """Open a database whose queue is that long, each shard with its job."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-benchmark-"))
    folder.chmod(0o711)
    try:
        with open_services(load_settings(state_dir=folder / "state", database_url=None)) as services:
            with services.database.transaction() as session:
                fill(session, n_shards)
            yield services.database, services.settings
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def fill(session: Session, n_shards: int) -> None:
    """Make the rows and jobs of evaluations with nine shards each."""
    numbers = {"submissions": -(-n_shards // SHARDS_OF_ONE), "shards": SHARDS_OF_ONE, "version": evaluator_version()}
    for statement in (TEAMS, SUBMISSIONS, EVALUATIONS, SHARDS):
        session.execute(text(statement), {name: value for name, value in numbers.items() if f":{name}" in statement})
    ids = session.scalars(select(Shard.id).order_by(Shard.id)).all()
    enqueue_shards(session, ids, queue_name(evaluator_version()), priority=0)


def measure(database: Database, settings: Settings, repeats: int) -> dict[str, float]:
    """Return the wall time of each by the client's clock, median and slowest [ms]."""
    with database.transaction() as session:
        ids = session.scalars(select(Shard.id).order_by(Shard.id).limit(SHARDS_OF_ONE)).all()
    pieces: dict[str, Callable[[Session], object]] = {
        "sweep": lambda session: sweep(session, settings, give_up=fail_by_machines),
        "withdraw_one_evaluation": lambda session: withdraw_jobs(session, ids),
        "forget": forget_jobs_of_ended_shards,
    }
    figures: dict[str, float] = {}
    for name, piece in pieces.items():
        times_ms = [time_ms(database, piece) for _ in range(repeats)]
        figures |= {f"{name}_ms": round(median(times_ms), 2), f"{name}_slowest_ms": round(max(times_ms), 2)}
    return figures


def time_ms(database: Database, piece: Callable[[Session], object]) -> float:
    """Return the time of one transaction, rolled back so that the next finds the same."""
    with database.transaction() as session:
        began = perf_counter()
        piece(session)
        elapsed_s = perf_counter() - began
        session.rollback()
    return 1000 * elapsed_s


if __name__ == "__main__":
    main()
