"""The service on a disk that fills up: what does not fit is refused whole, and all goes on when there is room."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from databases import state_directory
from service_client import Service, live_service, make_archive, problem_of
from small_disk import fill, make_room, small_disk
from vitac.server.settings import load_settings
from worker_fakes import eventually

DISK_BYTES = 128 << 20
"""An empty database takes half of it."""

LARGE = make_archive(
    {
        "Track_1/submission.yaml": "track: track_1\ntasks: [peg-insertion]\nname: large\n",
        "Track_1/policy.py": "class Policy: ...\n",
        "Track_1/weights": os.urandom(1 << 20),
    }
)


@pytest.fixture(scope="module")
def disk() -> Iterator[Path]:
    folder = state_directory()
    with small_disk(folder, DISK_BYTES) as disk:
        yield disk
    folder.rmdir()


@pytest.fixture(scope="module")
def live(disk: Path) -> Iterator[Service]:
    """A service whose state directory is on the small disk."""
    settings = load_settings(
        state_dir=disk, database_url=None, registrations_per_hour=10_000, client_share=1.0, sweep_interval_s=0.2
    )
    with live_service(settings) as service:
        yield service


@pytest.fixture
def full(disk: Path, live: Service) -> Iterator[None]:
    fill(disk)
    yield
    if (disk / "filler").exists():
        make_room(disk)


@pytest.mark.usefixtures("full")
def test_an_upload_that_does_not_fit_is_refused_and_leaves_nothing(live: Service, disk: Path) -> None:
    problem = problem_of(live.upload(LARGE), 507, "storage_full")
    assert "disk of the service is full" in problem["detail"]
    assert live.leftovers() == []
    assert live.get("/submissions").json()["items"] == []
    make_room(disk)
    assert live.upload(LARGE).status_code == 202


@pytest.mark.usefixtures("full")
def test_rows_that_do_not_fit_are_refused_and_none_is_half_there(live: Service, disk: Path) -> None:
    refused = register_until_refused(live)
    problem_of(refused[-1], 507, "storage_full")
    made = len(refused) - 1
    make_room(disk)
    assert register(live, "once more").status_code == 201
    assert count(live, "teams WHERE starts_with(name, 'Number')") == made
    assert count(live, "audit_log WHERE action = 'team.register' AND starts_with(after ->> 'name', 'Number')") == made


@pytest.mark.usefixtures("full")
def test_a_database_that_cannot_recover_comes_back_when_there_is_room(live: Service, disk: Path) -> None:
    postgres = live.services.postgres
    assert postgres is not None
    assert postgres.server_pid is not None
    before = count(live, "teams")
    os.kill(postgres.server_pid, signal.SIGKILL)
    make_room(disk)
    eventually(lambda: live.client.get("/ready").status_code == 200)
    assert count(live, "teams") == before
    assert register(live, "afterwards").status_code == 201


def register(live: Service, name: str) -> Any:
    return live.client.post("/api/v1/teams", json={"name": name, "contact": "x" * 200})


def register_until_refused(live: Service) -> list[Any]:
    answers = []
    for number in range(2000):
        answers.append(register(live, f"Number {number}"))
        if answers[-1].status_code != 201:
            break
    return answers


def count(live: Service, rows: str) -> int:
    with live.database.engine.connect() as connection:
        found: int = connection.exec_driver_sql(f"SELECT count(*) FROM {rows}").scalar_one()  # noqa: S608
        return found
