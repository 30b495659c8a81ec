"""How fast is the public log at 50,000 entries: one more, a checkpoint, a proof, a tile, and an audit of all?

Run it as `python benchmarks/public_log.py [--entries 50000] [--requests 200] [--json [FILE]]`. It starts a database of
its own. `append` is a transaction of its own each time, up to its commit. `cpu` is the time of this process without
the database.
"""

import argparse
import json
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from statistics import median, quantiles
from time import perf_counter, process_time

from sqlalchemy import insert
from vitac.server.database.engine import Database
from vitac.server.database.models import ReceiptRow, TreeNode
from vitac.server.receipts.log_audit import audit_log
from vitac.server.services import open_services
from vitac.server.settings import load_settings
from vitac.server.transparency.entries import FinalBoard
from vitac.server.transparency.log import (
    append,
    make_checkpoint,
    read_entries,
    read_hashes,
    read_log_key,
    read_tree,
)
from vitac.server.transparency.merkle import TILE_WIDTH, make_tree
from vitac.server.transparency.tiles import ENTRIES, PublishedLog, pack_entries, parse_tile_name


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--entries", type=int, default=50_000)
    parser.add_argument("--requests", type=int, default=200)
    parser.add_argument("--json", type=Path, nargs="?", const=Path("/dev/stdout"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="vitac-public-log-") as folder:
        Path(folder).chmod(0o755)
        with open_services(load_settings(state_dir=Path(folder))) as services:
            found = measure(services.database, options.entries, options.requests)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    else:
        print("\n".join(f"{name:<24}{value:>10.2f}" for name, value in found.items()))


def measure(database: Database, n_entries: int, n_requests: int) -> dict[str, float]:
    """Return times [ms], and for all entries together [s]."""
    began = perf_counter()
    fill(database, n_entries)
    found = {"filled_s": perf_counter() - began}

    def add() -> None:
        with database.transaction() as session:
            append(session, a_board)

    def sign() -> None:
        with database.transaction() as session:
            make_checkpoint(session, read_tree(session))

    def prove() -> None:
        with database.transaction() as session:
            read_tree(session).prove_inclusion(n_entries // 3)

    def compare() -> None:
        with database.transaction() as session:
            read_tree(session).prove_consistency(n_entries // 3)

    def read() -> None:
        with database.transaction() as session:
            pack_entries(read_entries(session, 1, 256))

    for name, work in {
        "append": add, "checkpoint": sign, "inclusion_proof": prove, "consistency_proof": compare, "entries_tile": read
    }.items():  # fmt: skip
        found |= measure_time(name, work, n_requests)
    began, cpu_began = perf_counter(), process_time()
    with database.transaction() as session:
        log = PublishedLog(lambda path: fetch(database, path), read_log_key(session))
    findings = audit_log(log).findings
    found |= {"audit_s": perf_counter() - began, "audit_cpu_s": process_time() - cpu_began}
    if findings:
        raise SystemExit(f"Expected no findings, got {findings[0]}")
    return found


def fill(database: Database, n_entries: int) -> None:
    """Write entries as `append` would, many at once."""
    entries = [a_board(datetime(2031, 1, 1, tzinfo=UTC)).entry(number) for number in range(1, n_entries + 1)]
    tree = make_tree([entry.leaf_hash for entry in entries])
    rows = [
        {
            "number": entry.number, "stands_for": entry.content, "content": "{}", "board": entry.board,
            "entry": entry.leaf().decode(), "leaf_hash": entry.leaf_hash,
        }
        for entry in entries
    ]  # fmt: skip
    with database.transaction() as session:
        session.execute(insert(ReceiptRow), rows)
        level, width = 1, n_entries // TILE_WIDTH
        while width:
            tiles = (
                tree.read_tile(level, at // TILE_WIDTH, min(TILE_WIDTH, width - at))
                for at in range(0, width, TILE_WIDTH)
            )
            hashes = (found for tile in tiles for found in tile)
            session.execute(insert(TreeNode), [{"level": level, "number": n, "hash": h} for n, h in enumerate(hashes)])
            level, width = level + 1, width // TILE_WIDTH


def a_board(at: datetime) -> FinalBoard:
    """Return the content of an entry that depends on no other row."""
    return FinalBoard(issued_at=at, competition="cup", track="track_1", stage="one", entries=9, board_sha256="0" * 64)


def measure_time(name: str, work: Callable[[], None], n_requests: int) -> dict[str, float]:
    """Return median and 99th percentile [ms], and the median of what this process has computed."""
    times, cpu = [], []
    for _ in range(n_requests):
        began, cpu_began = perf_counter(), process_time()
        work()
        times.append(1000 * (perf_counter() - began))
        cpu.append(1000 * (process_time() - cpu_began))
    return {
        f"{name}_median_ms": median(times),
        f"{name}_p99_ms": quantiles(times, n=100)[98],
        f"{name}_cpu_ms": median(cpu),
    }


def fetch(database: Database, path: str) -> bytes | None:
    """Return a file of the log as the routes make it, without HTTP."""
    with database.transaction() as session:
        if path == "checkpoint":
            return str(make_checkpoint(session, read_tree(session))).encode()
        if not path.startswith("tile/"):
            return None
        _, level, name = path.split("/", 2)
        tile = parse_tile_name(name)
        if tile is None:
            return None
        if level == ENTRIES:
            return pack_entries(read_entries(session, *tile))
        return b"".join(read_hashes(session, int(level), *tile))


if __name__ == "__main__":
    main()
