"""Measures workers on a real Slurm: one controller and two nodes on this machine, scaled with the queue.

Run it as root, as `python benchmarks/slurm.py [--submissions 3] [--json FILE]`, where Debian's package slurm-wlm is
installed. It starts a cluster and a service in temporary folders. Submissions wait before any worker is there; the
scaler is killed once, and so is a worker, while they are evaluated. The figures are void, and it exits with 1, unless
every evaluation is completed with the result of an undisturbed one and no job is left.
"""

import argparse
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from service import PEG_INSERTION, newest, running_shards, service, upload, wait_until
from sqlalchemy import func, select
from vitac.server.database.models import Worker
from vitac.server.database.states import EvaluationState
from vitac.server.services import Services

SCRIPT = Path(__file__).parents[1] / "docs" / "slurm" / "worker.sbatch"
IDLE_S = 10
"""Replaces the script's minute, so that the end of the jobs is seen sooner."""
LOOK_S = 0.5
POLL_S = 0.2


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--submissions", type=int, default=3, help="peg insertion policies that wait")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    if shutil.which("slurmctld") is None or os.geteuid() != 0:
        sys.exit("expected root, and a machine with slurmctld, slurmd and munged: `apt-get install slurm-wlm`")
    with cluster() as folder, service(0, 1) as (services, principal), ExitStack() as stack:
        ids = [upload(services, principal, PEG_INSERTION, note=f"# {n}\n") for n in range(arguments.submissions)]
        began = time.monotonic()
        figures: dict[str, Any] = {"submissions": len(ids), **disturbed(services, folder, stack)}
        wait_until(lambda: all(newest(services, one).state is EvaluationState.COMPLETED for one in ids), LOOK_S)
        figures["all_evaluated_after_s"] = round(time.monotonic() - began, 1)
        began = time.monotonic()
        wait_until(lambda: not jobs(), LOOK_S)
        figures["no_job_left_after_s"] = round(time.monotonic() - began, 1)
        hashes = {newest(services, one).result_hash for one in ids}
        with services.database.transaction() as session:
            figures["jobs"] = session.scalar(select(func.count()).select_from(Worker))
        figures["results"] = len(hashes)
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    if len(hashes) != 1:
        sys.exit("Evaluations of one policy have different results.")


def disturbed(services: Services, folder: Path, stack: ExitStack) -> dict[str, float]:
    """Start the scaler; kill it and a worker while they work; return when the first shard and the next one started."""
    script = folder / "worker.sbatch"
    script.write_text(SCRIPT.read_text().replace("--drain-when-idle 60", f"--drain-when-idle {IDLE_S}"))
    first = start_scaler(services, folder, script)
    began = time.monotonic()
    wait_until(lambda: running_shards(services) == 2, POLL_S)
    two_run_s = time.monotonic() - began
    first.send_signal(signal.SIGKILL)
    first.wait()
    job = next(iter(jobs()))
    run("scancel", "--signal=KILL", "--full", job)
    wait_until(lambda: job not in jobs(), POLL_S)
    killed = time.monotonic()
    second = start_scaler(services, folder, script)
    stack.callback(second.wait)
    stack.callback(second.terminate)
    wait_until(lambda: len(jobs()) == 2, POLL_S)
    return {
        "two_shards_run_after_s": round(two_run_s, 1),
        "killed_job_replaced_after_s": round(time.monotonic() - killed, 1),
    }


def start_scaler(services: Services, folder: Path, script: Path) -> "subprocess.Popen[bytes]":
    """Start `vitac scale slurm`, whose jobs inherit its environment."""
    command = ("vitac", "scale", "slurm", str(script), "--most", "2", "--every", "2")
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "VITAC_DATABASE_URL": services.database.address,
        "VITAC_STORAGE_URL": (services.settings.state_dir / "blobs").as_uri(),
    }
    return subprocess.Popen(command, cwd=folder, env=environment)  # noqa: S603 - our own command


def jobs() -> list[str]:
    """Return the ids of all jobs of the cluster."""
    return run("squeue", "--noheader", "--array", "--format=%i").split()


def run(*command: str) -> str:
    """Run one of Slurm's commands and return what it prints."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout  # noqa: S603 - Slurm's


@contextmanager
def cluster() -> Iterator[Path]:
    """Run munge, a controller and two nodes of two CPUs; the commands of this process and below it talk to them."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-slurm-"))
    folder.chmod(0o755)
    host = socket.gethostname().split(".")[0]
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge" / "key"
    key.write_bytes(os.urandom(1024))
    key.chmod(0o600)
    (folder / "slurm.conf").write_text(CONFIGURATION.format(folder=folder, host=host))
    os.environ["SLURM_CONF"] = str(folder / "slurm.conf")
    munge = [f"--{name}={folder}/munge/{name}" for name in ("key-file", "socket", "pid-file", "log-file", "seed-file")]
    munge[0] = f"--key-file={key}"
    daemons = (
        ("munged", "--foreground", "--force", *munge),
        ("slurmctld", "-D", "-f", str(folder / "slurm.conf")),
        ("slurmd", "-D", "-N", "n1", "-f", str(folder / "slurm.conf")),
        ("slurmd", "-D", "-N", "n2", "-f", str(folder / "slurm.conf")),
    )
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        for command in daemons:
            log = stack.enter_context((folder / f"{command[0]}.log").open("a"))
            process = subprocess.Popen(command, stdout=log, stderr=log)  # noqa: S603 - Slurm's
            stack.callback(process.wait)
            stack.callback(process.terminate)
            time.sleep(1)  # each needs the one before it
        wait_until(lambda: run("sinfo", "--noheader", "--format=%T %D").split() == ["idle", "2"], LOOK_S)
        yield folder


CONFIGURATION = """
ClusterName=bench
SlurmctldHost={host}(127.0.0.1)
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
SlurmUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldPort=16817
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_min_interval=1000000
SlurmdParameters=config_overrides
ReturnToService=2
NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port=16821 CPUs=1 RealMemory=12000
NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port=16822 CPUs=1 RealMemory=12000
PartitionName=work Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
"""


if __name__ == "__main__":
    main()
