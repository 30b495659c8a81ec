"""Measures uploads to `vitac serve` on this machine: MB/s, CPU time by part, and the server's peak memory.

Run it as `python benchmarks/uploads.py [--megabytes 400] [--repeats 3] [--json FILE]`. The submission is the example
policy with a file of random single-precision weights. A run counts from reading the packed file to the answer with the
submission, with all checks, hashing and storing; packing the folder, as `vitac submit FOLDER` does, is shown apart.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from vitac.cli.client.http import Client
from vitac.cli.client.pieces import pack

EXAMPLE = Path(__file__).parents[1] / "examples" / "peg_insertion_heuristic" / "Track_1"
MAIN = "from vitac.cli.main import main; main()"
MEGABYTE = 1_000_000
RESET_PEAK = "5"
"""What to write to `/proc/PID/clear_refs` to reset the peak of the resident memory."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=int, default=400)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="vitac-uploads-") as name:
        folder = Path(name)
        folder.chmod(0o711)
        with server(folder) as (process, client):
            runs = []
            for number in range(arguments.repeats):
                source = submission(folder / f"{number}", arguments.megabytes)
                runs.append(measure(process.pid, client, source))
                shutil.rmtree(source)
    figures = {
        "load_average_before": round(os.getloadavg()[0], 2),
        "megabytes": arguments.megabytes,
        "best_mb_per_s": max(run["mb_per_s"] for run in runs),
        "most_memory_added_mb": max(run["memory_added_mb"] for run in runs),
        "runs": runs,
    }
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


@contextmanager
def server(folder: Path) -> Iterator[tuple[subprocess.Popen[str], Client]]:
    """Run a service of its own and yield it with a client of a team."""
    with ExitStack() as stack:
        environment = os.environ | {"VITAC_STATE_DIR": str(folder / "state")}
        process = stack.enter_context(
            subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
                [sys.executable, "-c", MAIN, "serve", "--port", "0"],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        )
        stack.callback(process.terminate)
        assert process.stdout is not None  # noqa: S101 - asked for above
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        if found is None:
            raise SystemExit(f"The server did not start: {line!r}.")
        answer = httpx.post(f"{found[0]}/api/v1/teams", json={"name": "benchmark"}, trust_env=False)
        yield process, Client(server=found[0], token=answer.json()["token"]["secret"])


def submission(folder: Path, megabytes: int) -> Path:
    """Write the example policy and weights of that size; no two are the same submission."""
    shutil.copytree(EXAMPLE, folder)
    random = np.random.default_rng()
    with (folder / "weights.bin").open("wb") as target:
        for _ in range(megabytes):
            target.write(random.standard_normal(MEGABYTE // 4, np.float32).tobytes())
    return folder


def measure(pid: int, client: Client, source: Path) -> dict[str, Any]:
    """Pack and upload a folder and return what that took."""
    archive = source.with_suffix(".zip")
    packing = time.perf_counter()
    pack(source, archive)
    packing_s = time.perf_counter() - packing
    Path(f"/proc/{pid}/clear_refs").write_text(RESET_PEAK)
    memory_before, server_before, client_before = peak_mb(pid), cpu_s(pid), time.process_time()
    started = time.perf_counter()
    client.upload(archive, track="track_1", on_position=lambda _: None)
    took_s = time.perf_counter() - started
    megabytes = archive.stat().st_size / MEGABYTE
    archive.unlink()
    return {
        "mb_per_s": round(megabytes / took_s, 1),
        "packing_mb_per_s": round(megabytes / packing_s, 1),
        "wall_s": round(took_s, 2),
        "server_cpu_s": round(cpu_s(pid) - server_before, 2),
        "client_cpu_s": round(time.process_time() - client_before, 2),
        "memory_before_mb": memory_before,
        "memory_added_mb": round(peak_mb(pid) - memory_before, 1),
    }


def peak_mb(pid: int) -> float:
    """Return the peak of the resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return round(int(status.partition("VmHWM:")[2].split()[0]) * 1024 / MEGABYTE, 1)


def cpu_s(pid: int) -> float:
    """Return the CPU time of a process and its threads [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
