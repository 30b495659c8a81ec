"""docs/builder/animations.py: the episode of each environment is drawn once, and stands still where that is wished."""

import re
from pathlib import Path

import pytest
from animations import END_MS, ENV_STEP_MS, SHOWN, Shown, draw, element, files_of, write_animation
from PIL import Image, ImageSequence
from vitac.envs import ENVIRONMENTS
from vitac.evaluator.tracks import find_task

PEG = "ViTac/PegInsertion-v1"


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The tasks that were drawn, in order, by a stand-in for `vitac show`: the reset and one env step of each."""
    tasks: list[str] = []

    def show(task: str, *, out: Path, episode: int, every: str, width: int) -> None:
        assert (episode, every, width) == (shown_of(task).episode, "env-step", 640)
        tasks.append(task)
        out.mkdir()
        for number, colour in enumerate(("red", "blue")):
            Image.new("RGB", (64, 48), colour).save(out / f"{number}.png")
            print(f"{number}.png")  # noqa: T201 - as the command does

    monkeypatch.setattr("vitac.cli.show.command.command", show)
    return tasks


def shown_of(task: str) -> Shown:
    return next(shown for shown in SHOWN.values() if shown.task == task)


def test_every_environment_has_an_episode_of_its_own_list_and_words_for_it() -> None:
    assert SHOWN.keys() == ENVIRONMENTS.keys()
    for env_id, shown in SHOWN.items():
        task = find_task(shown.task)[1]
        assert task.env_id == env_id
        assert shown.episode in [episode.number for episode in task.episodes]
        assert len(shown.shows) > 60
        assert '"' not in shown.shows


def test_pictures_are_drawn_once_and_again_where_one_is_missing(
    tmp_path: Path, drawn: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    draw(folder)
    draw(folder)
    assert capsys.readouterr().out == "", "what the command says belongs to nobody who builds the site"
    assert drawn == [shown.task for shown in SHOWN.values()]
    assert sorted(path.name for path in folder.glob("*.webp")) == sorted(
        file.name for env_id in SHOWN for file in files_of(env_id, folder)
    )
    assert not [path for path in folder.iterdir() if path.is_dir()]
    files_of(PEG, folder)[1].unlink()
    (folder / SHOWN[PEG].task).mkdir()  # a build that was killed while it drew
    draw(folder)
    assert drawn[len(SHOWN) :] == [SHOWN[PEG].task]


def test_the_last_picture_stays_and_is_the_still(tmp_path: Path) -> None:
    pictures = [tmp_path / f"{number}.png" for number in range(3)]
    for path, colour in zip(pictures, ("red", "lime", "blue"), strict=True):
        Image.new("RGB", (64, 48), colour).save(path)
    animation, still = tmp_path / "all.webp", tmp_path / "still.webp"
    write_animation(pictures, animation, still)
    with Image.open(animation) as image:
        durations_ms = [frame.info["duration"] for frame in ImageSequence.Iterator(image) if frame.load()]
        assert image.info["loop"] == 0
    assert durations_ms == [ENV_STEP_MS, ENV_STEP_MS, END_MS]
    with Image.open(still) as image:
        red, _, blue = image.convert("RGB").getpixel((5, 5))  # type: ignore[misc]
    assert blue > 200 > red


@pytest.mark.usefixtures("drawn")
def test_those_who_prefer_less_motion_get_the_still_and_nothing_moves_when_it_loads(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    draw(folder)
    html = element(PEG, folder, above="..")
    assert re.search(r'reduce\)" srcset="\.\./_static/pictures/peg-insertion-still\.webp">', html)
    assert '<img src="../_static/pictures/peg-insertion.webp" width="64" height="48" loading="lazy" alt="A peg' in html
