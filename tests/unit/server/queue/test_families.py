"""Shards of a family of environments wait for workers that have its packages."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from cubes_track import FILE
from service_factories import TRACK, make_principal, make_settings, make_upload, submit, submit_to
from sqlalchemy import select
from sqlalchemy.orm import Session
from submission_steps import make_worker, view_of
from vitac.envs.tasks.definition import Family
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks.registry import find_version
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission, Work
from vitac.server.database.states import WorkState
from vitac.server.errors import ServiceError
from vitac.server.principals import CONSOLE
from vitac.server.queue.work import name_requirement
from vitac.server.queue.workers import fleet
from vitac.server.submissions import creation
from vitac.server.tracks import find_family

from competitions import make_competition, open_now, put_in_place

TACTILE = name_requirement(evaluator_version())
BOTH = ["tactile", "maniskill"]


@pytest.fixture(autouse=True)
def cubes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A track of ManiSkill beside ours, as an organizer adds it."""
    (tmp_path / "cubes.yaml").write_text(FILE)
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))


@pytest.fixture
def submission(database: Database) -> Submission:
    with database.transaction() as session:
        return submit_to(session, make_principal(session), track="cubes", task="pick-cube")


def requirement_of_cubes() -> str:
    """The requirement of the track beside ours, whose file makes its version another."""
    assert find_version("cubes") != evaluator_version()
    return name_requirement(find_version("cubes"), Family.MANISKILL)


def waiting(session: Session) -> dict[str, int]:
    """How many pieces of work wait for each requirement."""
    return dict(Counter(session.scalars(select(Work.requires).where(Work.state == WorkState.QUEUED))))


def test_the_family_of_a_task_follows_from_its_track_file(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_family("cubes", "pick-cube") is Family.MANISKILL
    assert find_family("track_1", "peg-insertion") is Family.TACTILE
    monkeypatch.delenv("VITAC_TRACKS_DIR")
    assert find_family("cubes", "pick-cube") is Family.TACTILE
    assert find_family("track_1", "gone") is Family.TACTILE


def test_new_shards_wait_for_workers_of_their_family(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        assert waiting(session) == {requirement_of_cubes(): 2}
        submit(session, make_principal(session, "Others"))
        assert waiting(session) == {requirement_of_cubes(): 2, TACTILE: 10}


@pytest.mark.parametrize(
    ("workers", "alive", "missing"),
    [
        ([], 0, None),
        ([{}], 0, "maniskill"),
        ([{"families": BOTH}, {}], 1, None),
        ([{"families": BOTH, "evaluator_version": "0+other"}, {}], 0, "maniskill"),
    ],
)
def test_a_submission_that_no_running_worker_can_play_says_so(
    database: Database, submission: Submission, workers: list[dict[str, Any]], alive: int, missing: str | None
) -> None:
    for changes in workers:
        make_worker(database, **changes)
    shown = view_of(database, CONSOLE, submission).workers
    assert (shown.alive, shown.missing_family) == (alive, missing)


@pytest.mark.parametrize(
    ("mode", "family"),
    [
        ("obs_mode: rgbd", "maniskill-pictures"),
        ("obs_mode: state, sim_backend: physx_cuda", "maniskill-cuda"),
    ],
)
def test_pictures_and_physics_on_a_gpu_wait_for_workers_whose_machine_can(
    database: Database, tmp_path: Path, mode: str, family: str
) -> None:
    (tmp_path / "cubes.yaml").unlink()
    folder = tmp_path / "others"
    folder.mkdir()
    (folder / "seen.yaml").write_text(FILE.replace("obs_mode: state", mode).replace("name: cubes", "name: seen"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VITAC_TRACKS_DIR", str(folder))
        with database.transaction() as session:
            seen = submit_to(session, make_principal(session), track="seen", task="pick-cube")
            assert waiting(session) == {name_requirement(find_version("seen"), Family(family)): 2}
        make_worker(database, families=BOTH)
        assert view_of(database, CONSOLE, seen).workers.missing_family == family
        make_worker(database, families=["tactile", family])
        assert view_of(database, CONSOLE, seen).workers.alive == 1


def test_tasks_of_ours_need_no_other_family(database: Database) -> None:
    make_worker(database)
    with database.transaction() as session:
        ours = submit(session, make_principal(session, "Others"))
    shown = view_of(database, CONSOLE, ours).workers
    assert (shown.alive, shown.missing_family) == (1, None)


def test_an_image_that_needs_a_gpu_waits_for_a_worker_that_declares_one(database: Database) -> None:
    make_worker(database)
    with database.transaction() as session:
        principal = make_principal(session, "Others")
        upload = make_upload(kind=SubmissionKind.IMAGE, manifest={"needs": "gpu"})
        ours = creation.create(session, principal, upload)[0]
        assert waiting(session) == {name_requirement(evaluator_version(), needs_gpu=True): 10}
    shown = view_of(database, CONSOLE, ours).workers
    assert (shown.alive, shown.lacks_gpu) == (0, True)
    make_worker(database, has_gpu=True)
    shown = view_of(database, CONSOLE, ours).workers
    assert (shown.alive, shown.lacks_gpu) == (1, False)


def test_a_stage_with_kernels_of_their_own_refuses_an_image_that_needs_a_gpu(database: Database) -> None:
    content = make_competition()
    content["tracks"][TRACK]["stages"][0] |= {"accepts": ["image"], "isolation": "vm"}
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        upload = make_upload(kind=SubmissionKind.IMAGE, manifest={"needs": "gpu"})
        with pytest.raises(ServiceError, match="plays with isolation vm, which has none"):
            creation.create(session, make_principal(session, "Others"), upload)


def test_workers_are_counted_by_family(database: Database) -> None:
    make_worker(database)
    make_worker(database, families=BOTH)
    with database.transaction() as session:
        known = fleet(session, make_settings())
    assert [known.alive(None, family).alive for family in (None, *Family)] == [2, 2, 1, 0, 0, 0]
    assert [known.alive("another", family).alive for family in (None, *Family)] == [0, 0, 0, 0, 0, 0]
