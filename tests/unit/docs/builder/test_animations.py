"""docs/builder/animations.py: the episode of each environment is drawn once, and stands still where that is wished."""

import re
import sys
from pathlib import Path

import pytest
from animations import END_MS, ENV_STEP_MS, SHOWN, draw, element, files_of, write_animation
from PIL import Image, ImageSequence
from vitac.envs import ENVIRONMENTS
from vitac.evaluator.tracks import find_task

PEG = "ViTac/PegInsertion-v1"
# Stands in for this Python with `vitac show`: writes a picture for the reset and one for an env step.
FAKE_SHOW = f"""#!/bin/sh
for out; do :; done
echo "$3" >>"${{out%/*}}/calls"
exec '{sys.executable}' -c '
import pathlib, sys
from PIL import Image
folder = pathlib.Path(sys.argv[1]); folder.mkdir()
for number, colour in enumerate(("red", "blue")): Image.new("RGB", (64, 48), colour).save(folder / f"{{number}}.png")
' "$out"
"""


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    program = tmp_path / "python"
    program.write_text(FAKE_SHOW)
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    return tmp_path / "pictures" / "calls"


def test_every_environment_has_an_episode_of_its_own_list_and_words_for_it() -> None:
    assert SHOWN.keys() == ENVIRONMENTS.keys()
    for env_id, shown in SHOWN.items():
        task = find_task(shown.task)[1]
        assert task.env_id == env_id
        assert shown.episode in [episode.number for episode in task.episodes]
        assert len(shown.shows) > 60
        assert '"' not in shown.shows


def test_pictures_are_drawn_once_and_again_where_one_is_missing(tmp_path: Path, calls: Path) -> None:
    folder = tmp_path / "pictures"
    draw(folder)
    draw(folder)
    assert sorted(calls.read_text().split()) == sorted(shown.task for shown in SHOWN.values())
    assert sorted(path.name for path in folder.glob("*.webp")) == sorted(
        file.name for env_id in SHOWN for file in files_of(env_id, folder)
    )
    assert not [path for path in folder.iterdir() if path.is_dir()]
    files_of(PEG, folder)[1].unlink()
    (folder / SHOWN[PEG].task).mkdir()  # a build that was killed while it drew
    draw(folder)
    assert calls.read_text().split()[len(SHOWN) :] == [SHOWN[PEG].task]


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


def test_those_who_prefer_less_motion_get_the_still_and_nothing_moves_when_it_loads(
    tmp_path: Path, calls: Path
) -> None:
    folder = tmp_path / "pictures"
    draw(folder)
    html = element(PEG, folder, above="..")
    assert re.search(r'reduce\)" srcset="\.\./_static/pictures/peg-insertion-still\.webp">', html)
    assert '<img src="../_static/pictures/peg-insertion.webp" width="64" height="48" loading="lazy" alt="A peg' in html
