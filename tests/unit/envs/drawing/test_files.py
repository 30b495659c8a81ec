import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from vitac.envs.drawing.files import Destination, Kind, PicturesNotWritable

GREEN = np.full((6, 8, 3), (20, 200, 60), dtype=np.uint8)
RED = np.full((6, 8, 3), (200, 20, 60), dtype=np.uint8)
NAMES = ("step-00", "step-01")
DURATIONS_MS = (100, 2500)


def write(destination: Destination) -> list[Path]:
    return destination.write([GREEN, RED], names=NAMES, durations_ms=DURATIONS_MS)


def test_png_is_the_picture(tmp_path: Path) -> None:
    destination = Destination.at(tmp_path / "a.png")
    assert destination.write([RED], names=NAMES[:1], durations_ms=DURATIONS_MS[:1]) == [tmp_path / "a.png"]
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), RED)


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "A.GIF"])
def test_animation_shows_all_pictures_for_their_times(tmp_path: Path, name: str) -> None:
    assert write(Destination.at(tmp_path / name)) == [tmp_path / name]
    with Image.open(tmp_path / name) as image:
        assert image.size == (8, 6)
        assert image.n_frames == 2  # type: ignore[attr-defined]
        assert image.info["loop"] == 0
        for index, expected in enumerate((GREEN, RED)):
            image.seek(index)
            image.load()
            assert image.info["duration"] == DURATIONS_MS[index]
            assert np.abs(np.asarray(image.convert("RGB")).astype(int) - expected).max() <= 12


def test_folder_holds_one_png_for_each_moment(tmp_path: Path) -> None:
    written = write(Destination.at(tmp_path / "frames"))
    assert [path.name for path in written] == ["step-00.png", "step-01.png"]
    assert sorted((tmp_path / "frames").iterdir()) == written


def test_an_existing_file_is_replaced_only_when_pictures_come(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    destination = Destination.at(path)
    assert path.read_bytes() == b"old"
    destination.write([RED], names=NAMES[:1], durations_ms=DURATIONS_MS[:1])
    assert path.read_bytes().startswith(b"\x89PNG")


def test_looking_leaves_no_file_behind(tmp_path: Path) -> None:
    for name in ("a.png", "a.gif", "a.webp"):
        assert Destination.at(tmp_path / name).kind is Kind(Path(name).suffix)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.jpg", "a.mp4", "a.png.txt", "run.1"])
def test_other_suffix_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PicturesNotWritable, match=r"expected \.png, \.gif, \.webp, or no suffix for a folder"):
        Destination.at(tmp_path / name)


def test_missing_parent_is_refused(tmp_path: Path) -> None:
    for name in ("a.png", "frames"):
        with pytest.raises(PicturesNotWritable, match=r"Cannot write pictures to .*nowhere.*No such file or directory"):
            Destination.at(tmp_path / "nowhere" / name)


def test_folder_in_the_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(PicturesNotWritable, match="Is a directory"):
        Destination.at(tmp_path / "a.png")


def test_file_in_the_place_of_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "frames").write_text("")
    with pytest.raises(PicturesNotWritable, match="File exists"):
        Destination.at(tmp_path / "frames")


def test_folder_with_something_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "step-07.png").write_text("")
    with pytest.raises(PicturesNotWritable, match=r"is not empty \(step-07.png\); name a new one"):
        Destination.at(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PicturesNotWritable, match="Permission denied"):
        Destination.at(tmp_path / "a.png")
    tmp_path.chmod(0o700)


def test_a_disk_that_fills_up_is_told(tmp_path: Path) -> None:
    destination = Destination(path=Path("/dev/full"), kind=Kind.PNG)
    with pytest.raises(PicturesNotWritable):
        destination.write([RED], names=NAMES[:1], durations_ms=DURATIONS_MS[:1])
