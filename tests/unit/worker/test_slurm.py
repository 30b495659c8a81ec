"""The scaler asks for as many jobs as the queue has work for, and takes back those that wait in vain."""

import os
import signal
import threading
from pathlib import Path

import pytest
from service_factories import make_principal, make_upload
from sqlalchemy import text
from vitac.server.queue.work import count_open
from vitac.server.services import Services
from vitac.server.submissions import creation
from vitac.worker.slurm import Scaling, SlurmError, SlurmScaler
from worker_fakes import eventually

COMMAND = (
    '#!/bin/sh\necho "$0 $*" >>"$(dirname "$0")/calls"\ncat "$(dirname "$0")/answer.$(basename "$0")" 2>/dev/null\n'
)


class FakeSlurm:
    """Stands for Slurm's commands: answers with the jobs that it was given, and notes what is called."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("squeue", "sbatch", "scancel"):
            self.put(name, COMMAND + "true\n")

    def put(self, name: str, content: str) -> None:
        (self.folder / name).write_text(content)
        (self.folder / name).chmod(0o755)

    def has(self, *jobs: str) -> None:
        (self.folder / "answer.squeue").write_text("".join(f"{job}\n" for job in jobs))

    def calls(self, name: str) -> list[list[str]]:
        lines = (self.folder / "calls").read_text().splitlines()
        return [line.split()[1:] for line in lines if line.split()[0].endswith(f"/{name}")]


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeSlurm:
    folder = tmp_path / "slurm"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    return FakeSlurm(folder)


@pytest.fixture
def work(services: Services, archive_sha256: str) -> int:
    with services.database.transaction() as session:
        creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))
    with services.database.transaction() as session:
        return count_open(session)


def make_scaler(services: Services, most: int = 4, slots: int = 1) -> SlurmScaler:
    return SlurmScaler(services=services, script=Path("worker.sbatch"), most=most, slots=slots)


def test_missing_jobs_are_submitted_as_one_array_up_to_the_limit(
    services: Services, slurm: FakeSlurm, work: int
) -> None:
    assert work > 4
    slurm.has("17_1 RUNNING")
    assert make_scaler(services).scale() == Scaling(work=work, running=1, pending=0, submitted=3)
    (submitted,) = slurm.calls("sbatch")
    assert {"--job-name=vitac-worker", "--cpus-per-task=1", "--array=1-3"} <= set(submitted)
    assert submitted[-1] == "worker.sbatch"


def test_a_job_with_several_slots_counts_for_as_many_shards(services: Services, slurm: FakeSlurm, work: int) -> None:
    slurm.has()
    assert make_scaler(services, most=99, slots=work).scale().submitted == 1


def test_without_work_waiting_jobs_are_cancelled_and_running_ones_end_by_themselves(
    services: Services, slurm: FakeSlurm
) -> None:
    slurm.has("17_1 RUNNING", "17_2 PENDING", "18_1 PENDING")
    assert make_scaler(services).scale() == Scaling(work=0, running=1, pending=2, cancelled=2)
    assert slurm.calls("scancel") == [["--state=PENDING", "17_2", "18_1"]]
    assert slurm.calls("sbatch") == []


def test_no_transaction_is_open_while_slurm_takes_its_time(services: Services, slurm: FakeSlurm, work: int) -> None:
    slurm.put("squeue", f"#!/bin/sh\nsleep 600 & echo $! >{slurm.folder}/pid; wait\n")
    scaling = threading.Thread(target=make_scaler(services).scale)
    scaling.start()
    eventually(lambda: (slurm.folder / "pid").exists() and (slurm.folder / "pid").read_text().endswith("\n"))
    with services.database.transaction() as session:
        open_ones = session.scalar(
            text(
                "SELECT count(*) FROM pg_stat_activity WHERE state LIKE 'idle in transaction%'"
                " AND datname = current_database()"
            )
        )
    os.kill(int((slurm.folder / "pid").read_text()), signal.SIGKILL)
    scaling.join()
    assert open_ones == 0


def test_enough_jobs_are_left_alone(services: Services, slurm: FakeSlurm, work: int) -> None:
    slurm.has("1_1 RUNNING", "1_2 RUNNING", "1_3 PENDING", "1_4 CONFIGURING")
    assert make_scaler(services).scale() == Scaling(work=work, running=3, pending=1)
    assert slurm.calls("sbatch") + slurm.calls("scancel") == []


def test_nothing_is_submitted_while_slurm_does_not_say_what_runs(
    services: Services, slurm: FakeSlurm, work: int
) -> None:
    slurm.put("squeue", "#!/bin/sh\necho 'Unable to contact slurm controller' >&2\nexit 1\n")
    with pytest.raises(SlurmError, match="`squeue` failed: Unable to contact slurm controller"):
        make_scaler(services).scale()
    assert not (slurm.folder / "calls").exists()


def test_machine_without_slurm_is_named(services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SlurmError, match="`squeue` is not on this machine: run the scaler where jobs are submitted"):
        make_scaler(services).scale()
