"""Pictures of ManiSkill's scenes: what is kept, and that every picture that is shipped shows something."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from vitac.envs.maniskill.catalogue import catalogue
from vitac.envs.maniskill.scenes import HEIGHT, WIDTH, NothingDrawn, file_name, write


def test_a_picture_is_cut_to_the_size_of_all(tmp_path: Path) -> None:
    drawn = np.zeros((512, 512, 3), np.uint8)
    drawn[200:300] = 255
    write(drawn, tmp_path / "scene.jpg")
    with Image.open(tmp_path / "scene.jpg") as image:
        assert image.size == (WIDTH, HEIGHT)
        assert np.asarray(image)[:, :, 0].max() > 200


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_placeholder_is_refused_and_not_written(tmp_path: Path, value: int) -> None:
    with pytest.raises(NothingDrawn, match=r"has a contrast of 0\.0, expected at least 8"):
        write(np.full((64, 64, 3), value, np.uint8), tmp_path / "scene.jpg")
    assert list(tmp_path.iterdir()) == []


def test_every_environment_that_can_be_a_task_has_a_small_picture_that_shows_something(repository: Path) -> None:
    shipped = sorted((repository / "web" / "static").glob("scene-*.jpg"))
    assert {path.name for path in shipped} == {file_name(env_id) for env_id in catalogue().environments}
    for path in shipped:
        assert path.stat().st_size < 60_000
        with Image.open(path) as image:
            assert image.size == (WIDTH, HEIGHT)
            assert np.asarray(image.convert("L")).std() > 8
