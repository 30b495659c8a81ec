"""Films of recorded episodes, on the stand-in for ManiSkill."""

import weakref
from pathlib import Path

import numpy as np
import pytest
from fake_pick_cube import FakePickCube, in_place_of_maniskill
from PIL import Image
from resimulated_record import resimulated_record
from vitac.envs.maniskill.env import ManiSkillMissing
from vitac.envs.maniskill.film import Shot
from vitac.evaluator import playback
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.playback import (
    FILM_FILE,
    STILL_FILE,
    WIDTH_PX,
    NotPlayable,
    PlaybackOrder,
    StatesDiffer,
    make,
    make_film,
    require_playable,
)
from vitac.evaluator.tracks import Task, find_task


@pytest.fixture
def task(fake: FakePickCube) -> Task:
    fake.single_action_space.shape = (4,)
    return find_task("pick-cube")[1]


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakePickCube:
    return in_place_of_maniskill(monkeypatch)


def recorded(task: Task, env_steps: int = 3, number: int = 2) -> EpisodeRecord:
    return resimulated_record(task, number, np.full((env_steps, 4), 0.5, np.float32))


def test_a_film_shows_every_recorded_env_step_and_ends_with_the_still(
    task: Task, fake: FakePickCube, tmp_path: Path
) -> None:
    told: list[int] = []
    make(PlaybackOrder(track="maniskill", record=recorded(task), folder=tmp_path), told.append)
    assert (told, fake.draws) == ([0, 1, 2, 3], True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [FILM_FILE, STILL_FILE]
    with Image.open(tmp_path / FILM_FILE) as moving, Image.open(tmp_path / STILL_FILE) as still:
        assert (moving.n_frames, moving.width, still.width) == (4, WIDTH_PX, WIDTH_PX)  # type: ignore[attr-defined]
        brightness = []
        for index in range(4):
            moving.seek(index)
            brightness.append(float(np.asarray(moving.convert("L")).mean()))
        assert brightness == sorted(brightness)
        assert brightness[0] < brightness[-1] == pytest.approx(float(np.asarray(still.convert("L")).mean()), abs=2)


def test_the_start_is_that_of_the_list_which_was_played(task: Task, fake: FakePickCube, tmp_path: Path) -> None:
    record = recorded(task)
    make_film(task, record, lambda _: None, tmp_path)
    (of_record, _), (of_film, _) = fake.resets
    assert of_film == of_record
    with pytest.raises(StatesDiffer, match="after env step 0"):
        make_film(task, record, lambda _: None, tmp_path, list_seed=7)


@pytest.mark.parametrize("wrong", [0, 2])
def test_another_state_than_the_recorded_one_is_not_shown(task: Task, tmp_path: Path, wrong: int) -> None:
    record = recorded(task)
    hashes = list(record.state_hashes)
    hashes[wrong] = "f" * 64
    with pytest.raises(StatesDiffer, match=f"after env step {wrong} is not the recorded one"):
        make_film(task, record.model_copy(update={"state_hashes": tuple(hashes)}), lambda _: None, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_no_more_than_a_few_pictures_are_in_memory_at_once(
    task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[weakref.ref[np.ndarray]] = []
    most = 0

    def captioned(shot: Shot, *_: object) -> np.ndarray:
        nonlocal most
        picture = shot.picture.copy()
        made.append(weakref.ref(picture))
        most = max(most, sum(it() is not None for it in made))
        return picture

    monkeypatch.setattr("vitac.envs.maniskill.film.captioned", captioned)
    make_film(task, recorded(task, env_steps=20), lambda _: None, tmp_path)
    assert (len(made), most <= 3) == (21, True)


def test_an_episode_that_ends_before_its_record_is_not_shown(task: Task, fake: FakePickCube, tmp_path: Path) -> None:
    record = recorded(task, env_steps=4)
    fake.solves = True
    with pytest.raises(StatesDiffer, match="Expected 4 env steps as recorded, got 3"):
        make_film(task, record, lambda _: None, tmp_path)


def test_without_a_driver_the_refusal_says_what_to_install(
    task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = recorded(task)

    def no_driver(*_: object, **__: object) -> None:
        raise ManiSkillMissing("A picture of it is drawn by SAPIEN, which finds no Vulkan driver.")

    monkeypatch.setattr("vitac.envs.maniskill.env.made", no_driver)
    with pytest.raises(ManiSkillMissing, match="no Vulkan driver"):
        playback.make_film(task, record, lambda _: None, tmp_path)


def test_what_does_not_repeat_has_no_playbacks(task: Task) -> None:
    require_playable(task)
    on_gpu = task.model_copy(update={"settings": dict(task.settings) | {"sim_backend": "physx_cuda"}})
    with pytest.raises(NotPlayable, match=r"no playbacks of ManiSkill/PickCube-v1 .* its states do not repeat"):
        require_playable(on_gpu)


def test_what_is_played_on_a_station_has_no_playbacks(task: Task) -> None:
    with pytest.raises(NotPlayable, match=f"no playbacks of {task.name}: it is played on a station"):
        require_playable(task.model_copy(update={"station_of": "peg-insertion"}))
