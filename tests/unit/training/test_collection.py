"""Collecting episodes: the same files however it is done."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.envs.fem.model.settings import ContactModel
from vitac.training.collection import FILE_EPISODES, ActorKind, CollectedBatch, Networks, _versions, collect
from vitac.training.episodes import TASK
from vitac.training.learning.critic import Critic, CriticPlan
from vitac.training.learning.student import Student, StudentPlan, make_weights
from vitac.training.streams import Use, stream

BATCH = CollectedBatch(kind=ActorKind.RANDOM, seed=1, use=Use.COLLECT, first=0, count=FILE_EPISODES + 10)
PLAN = CriticPlan(networks=1, hidden=8)


def networks(seed: int = 0) -> Networks:
    random = np.random.default_rng(seed)
    critic, student = Critic(PLAN, random), Student(StudentPlan(networks=1, hidden=8), random)
    return Networks(plan=PLAN, critic=critic.state(), student=make_weights(student.state()))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_files_are_the_same_however_many_processes_play(tmp_path: Path) -> None:
    batch = replace(BATCH, count=3 * FILE_EPISODES)
    one = collect(batch, tmp_path / "one")
    three = collect(batch, tmp_path / "three", processes=3)
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, three.arrays()[name])


def test_what_is_there_is_not_played_again(tmp_path: Path, toy: list[ToyPeg]) -> None:
    heard: list[tuple[int, int]] = []
    first = collect(BATCH, tmp_path)
    played = len(toy[0].resets)
    again = collect(BATCH, tmp_path, report_file=lambda done, files: heard.append((done, files)))
    assert played == len(toy[0].resets) == len(first) == len(again) == BATCH.count
    assert heard == [(2, 2)]


def test_damaged_file_is_played_again(tmp_path: Path, toy: list[ToyPeg]) -> None:
    collect(BATCH, tmp_path)
    before = contents(tmp_path)
    damaged = next(tmp_path.iterdir())
    damaged.write_bytes(b"")
    collect(BATCH, tmp_path)
    assert contents(tmp_path) == before


def test_stopped_collection_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(done: int, _: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(BATCH, tmp_path, report_file=stop)
    assert len(contents(tmp_path)) == 1
    collect(BATCH, tmp_path)
    collect(BATCH, tmp_path / "whole")
    whole = contents(tmp_path / "whole")
    assert contents_of_files(tmp_path) == whole


def contents_of_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


def test_episodes_are_those_of_the_stream(tmp_path: Path, toy: list[ToyPeg]) -> None:
    collect(replace(BATCH, first=700, count=3, use=Use.CHOOSE), tmp_path)
    assert toy[0].resets == [(stream(1, Use.CHOOSE), number) for number in (700, 701, 702)]


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 2},
        {"use": Use.CHOOSE},
        {"kind": ActorKind.GUIDED},
        {"first": 1},
        {"noise": 0.1},
        {"contact_model": ContactModel.ARENA_2},
    ],
)
def test_other_episodes_have_other_files(tmp_path: Path, change: dict[str, object]) -> None:
    batch = replace(BATCH, count=2)
    collect(batch, tmp_path)
    collect(replace(batch, **change), tmp_path)  # type: ignore[arg-type]
    assert len(contents(tmp_path)) == 2


def test_another_version_of_the_simulation_has_other_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    batch = replace(BATCH, count=2)
    collect(batch, tmp_path)
    monkeypatch.setattr("vitac.training.collection.evaluator_hash", lambda: "another")
    _versions.cache_clear()
    collect(batch, tmp_path)
    assert len(contents(tmp_path)) == 2


@pytest.mark.parametrize("kind", [ActorKind.CRITIC, ActorKind.STUDENT])
def test_other_networks_have_other_files(tmp_path: Path, kind: ActorKind) -> None:
    batch = replace(BATCH, kind=kind, count=2)
    for seed in (0, 0, 1):
        collect(batch, tmp_path, networks=networks(seed))
    assert len(contents(tmp_path)) == 2


def test_networks_that_do_not_act_do_not_matter(tmp_path: Path) -> None:
    batch = replace(BATCH, kind=ActorKind.STUDENT, count=2)
    first = networks()
    collect(batch, tmp_path, networks=first)
    collect(batch, tmp_path, networks=replace(first, critic=networks(1).critic))
    assert len(contents(tmp_path)) == 1


def test_task_is_that_of_the_official_list() -> None:
    from vitac.evaluator.tracks import find_task
    from vitac.training.episodes import ENV_ID

    assert find_task(TASK)[1].env_id == ENV_ID
