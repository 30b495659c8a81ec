"""Keeps as many Slurm jobs with workers as the queue has work for.

Slurm holds all that has to be remembered: a scaler that is killed and started again works as before, and two of them
do no harm.
"""

import os
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.exc import DBAPIError
from vitac.errors import VitacError
from vitac.server.database.availability import DatabaseUnreachable
from vitac.server.queue.work import count_open
from vitac.server.services import Services

JOB_NAME = "vitac-worker"

_COMMAND_S = 60.0
"""How long one of Slurm's commands may take [s]."""


class SlurmError(VitacError):
    """A command of Slurm is missing, failed, or did not answer."""


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """What one look at queue and jobs found and did.

    Attributes:
        work: pieces of work that wait or run.
        running: jobs that run.
        pending: jobs that wait for a machine, before anything was done about it.
        submitted: jobs that were added.
        cancelled: pending jobs that nobody needs any longer and that were taken back.
    """

    work: int
    running: int
    pending: int
    submitted: int = 0
    cancelled: int = 0


@dataclass(frozen=True, kw_only=True)
class SlurmScaler:
    """Submits a batch script whose jobs are workers which end by themselves when they are idle.

    Attributes:
        services: whose queue is looked at.
        script: given to `sbatch`.
        most: jobs that wait or run at the same time.
        slots: shards that a job runs at the same time, each on a CPU.
    """

    services: Services
    script: Path
    most: int
    slots: int

    def scale(self) -> Scaling:
        """Look at queue and jobs; submit what is missing, or cancel jobs that wait in vain.

        Raises:
            SlurmError: Slurm refused, or does not answer.
            DatabaseUnreachable: the database does not.
        """
        try:
            with self.services.database.transaction() as session:
                work = count_open(session)
        except DBAPIError as error:
            raise DatabaseUnreachable.from_driver(error) from error
        return self._scale(work)

    def _scale(self, work: int) -> Scaling:
        jobs = _list_jobs()
        states = Counter(jobs.values())
        pending = [job for job, state in jobs.items() if state == "PENDING"]
        wanted = min(self.most, -(-work // self.slots))
        missing = wanted - len(jobs)
        cancelled = pending[:-missing] if missing < 0 else []
        if missing > 0:
            self._submit(missing)
        if cancelled:
            _call("scancel", "--state=PENDING", *cancelled)
        return Scaling(
            work=work,
            running=len(jobs) - states["PENDING"],
            pending=states["PENDING"],
            submitted=max(0, missing),
            cancelled=len(cancelled),
        )

    def _submit(self, count: int) -> None:
        options = (f"--job-name={JOB_NAME}", f"--cpus-per-task={self.slots}", f"--array=1-{count}")
        _call("sbatch", "--parsable", *options, str(self.script), environment={"VITAC_WORKER_SLOTS": str(self.slots)})


def _list_jobs() -> dict[str, str]:
    """Return the state of each of our jobs that waits, starts or runs."""
    states = "PENDING,CONFIGURING,RUNNING,SUSPENDED,REQUEUED"
    options = ("--me", "--noheader", "--array", f"--name={JOB_NAME}", f"--states={states}", "--format=%i %T")
    return dict(line.split(maxsplit=1) for line in _call("squeue", *options).splitlines())


def _call(*command: str, environment: dict[str, str] | None = None) -> str:
    try:
        done = subprocess.run(  # noqa: S603 - Slurm's programs, as the shell finds them
            command,
            env={**os.environ, **(environment or {})},
            capture_output=True,
            text=True,
            timeout=_COMMAND_S,
            check=False,
        )
    except FileNotFoundError as error:
        raise SlurmError(f"`{command[0]}` is not on this machine: run the scaler where jobs are submitted.") from error
    except subprocess.TimeoutExpired as error:
        raise SlurmError(f"`{command[0]}` did not answer within {_COMMAND_S:.0f} s.") from error
    if done.returncode != 0:
        raise SlurmError(f"`{command[0]}` failed: {' '.join(done.stderr.split()) or f'exit code {done.returncode}'}")
    return done.stdout
