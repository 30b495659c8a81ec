import errno
import os
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from PIL import Image
from vitac.envs.drawing.files import Destination, Format, Frame, PicturesNotWritable

GREEN = np.full((6, 8, 3), (20, 200, 60), dtype=np.uint8)
RED = np.full((6, 8, 3), (200, 20, 60), dtype=np.uint8)
DURATIONS_MS = (100, 2500)


def write(destination: Destination) -> list[Path]:
    first, second = (frame(picture, index) for index, picture in enumerate((GREEN, RED)))
    return destination.write([first, second], end_ms=DURATIONS_MS[1])


def frame(picture: np.ndarray = RED, index: int = 0) -> Frame:
    return Frame(picture=picture, name=f"step-{index:02}", duration_ms=DURATIONS_MS[0])


def test_png_is_the_picture(tmp_path: Path) -> None:
    destination = Destination.from_path(tmp_path / "a.png")
    assert destination.write([frame()]) == [tmp_path / "a.png"]
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), RED)


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "A.GIF"])
def test_animation_shows_all_pictures_for_their_times(tmp_path: Path, name: str) -> None:
    assert write(Destination.from_path(tmp_path / name)) == [tmp_path / name]
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
    written = write(Destination.from_path(tmp_path / "frames"))
    assert [path.name for path in written] == ["step-00.png", "step-01.png"]
    assert sorted((tmp_path / "frames").iterdir()) == written


def test_an_existing_file_is_replaced_only_when_pictures_come(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    destination = Destination.from_path(path)
    assert path.read_bytes() == b"old"
    destination.write([frame()])
    assert path.read_bytes().startswith(b"\x89PNG")


def test_looking_leaves_no_file_behind(tmp_path: Path) -> None:
    for name in ("a.png", "a.gif", "a.webp"):
        assert Destination.from_path(tmp_path / name).format is Format(Path(name).suffix)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.jpg", "a.mp4", "a.png.txt", "run.1"])
def test_other_suffix_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PicturesNotWritable, match=r"expected \.png, \.gif, \.webp, or no suffix for a folder"):
        Destination.from_path(tmp_path / name)


def test_missing_parent_is_refused(tmp_path: Path) -> None:
    for name in ("a.png", "frames"):
        with pytest.raises(PicturesNotWritable, match=r"Cannot write pictures to .*nowhere.*No such file or directory"):
            Destination.from_path(tmp_path / "nowhere" / name)


def test_folder_in_the_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(PicturesNotWritable, match="Is a directory"):
        Destination.from_path(tmp_path / "a.png")


def test_file_in_the_place_of_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "frames").write_text("")
    with pytest.raises(PicturesNotWritable, match="File exists"):
        Destination.from_path(tmp_path / "frames")


def test_folder_with_something_in_it_is_refused(tmp_path: Path) -> None:
    (tmp_path / "step-07.png").write_text("")
    with pytest.raises(PicturesNotWritable, match=r"is not empty \(step-07.png\); name a new one"):
        Destination.from_path(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PicturesNotWritable, match="Permission denied"):
        Destination.from_path(tmp_path / "a.png")
    tmp_path.chmod(0o700)


def test_a_disk_that_fills_up_is_told(tmp_path: Path) -> None:
    destination = Destination(path=Path("/dev/full"), format=Format.PNG)
    with pytest.raises(PicturesNotWritable):
        destination.write([frame()])


@pytest.mark.parametrize("name", ["a.gif", "a.webp", "frames"])
def test_each_picture_is_let_go_before_the_one_after_the_next_is_asked_for(tmp_path: Path, name: str) -> None:
    """A long episode has more pictures than memory holds."""
    alive: list[weakref.ref[np.ndarray]] = []
    most = 0

    def frames() -> Iterator[Frame]:
        nonlocal most
        for index in range(6):
            picture = np.full((60, 80, 3), 40 * index, np.uint8)
            alive.append(weakref.ref(picture))
            most = max(most, sum(it() is not None for it in alive))
            yield frame(picture, index)
            del picture

    Destination.from_path(tmp_path / name).write(frames())
    assert most <= 2


@pytest.mark.parametrize("name", ["a.png", "a.gif", "a.webp", "frames"])
def test_of_no_pictures_nothing_is_written(tmp_path: Path, name: str) -> None:
    assert Destination.from_path(tmp_path / name).write([]) == []
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_an_error_while_pictures_are_made_is_not_one_of_writing_and_leaves_an_old_file(tmp_path: Path) -> None:
    def frames() -> Iterator[Frame]:
        yield frame()
        raise OSError("the camera is gone")

    path = tmp_path / "a.webp"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="the camera is gone"):
        Destination.from_path(path).write(frames())
    assert [(found.name, found.read_bytes()) for found in tmp_path.iterdir()] == [("a.webp", b"old")]


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_a_disk_that_fills_up_leaves_the_old_animation_and_no_half_a_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def fills_up(image: Image.Image, file: BinaryIO, filename: str) -> None:
        file.write(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path, alias = tmp_path / name, tmp_path / f"alias-{name}"
    write(Destination.from_path(path))
    before = path.read_bytes()
    alias.symlink_to(path)
    with monkeypatch.context() as patch:
        patch.setitem(Image.SAVE_ALL, path.suffix[1:].upper(), fills_up)
        for destination in (path, alias, tmp_path / f"new-{name}"):
            with pytest.raises(PicturesNotWritable, match=f"{destination.name}: No space left on device"):
                write(Destination.from_path(destination))
    assert sorted(tmp_path.iterdir()) == [path, alias]
    assert path.read_bytes() == before
    Destination.from_path(alias).write([frame()])
    assert alias.is_symlink(), "what it points at is replaced"
    assert path.read_bytes() != before


def test_a_place_that_has_gone_is_told(tmp_path: Path) -> None:
    for name in ("a.png", "a.webp"):
        (tmp_path / "gone").mkdir()
        destination = Destination.from_path(tmp_path / "gone" / name)
        (tmp_path / "gone").rmdir()
        with pytest.raises(PicturesNotWritable, match="No such file or directory"):
            destination.write([frame()])
