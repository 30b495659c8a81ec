import errno
from pathlib import Path

import pytest
from vitac.server.storage.scratch import new_file


def test_a_file_gets_its_name_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "export.zip"
    with new_file(path) as unfinished:
        unfinished.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_left_after_an_error_and_the_name_is_free(tmp_path: Path) -> None:
    def write_half() -> None:
        with new_file(tmp_path / "export.zip") as unfinished:
            unfinished.write_text("half")
            raise ValueError("half")

    with pytest.raises(ValueError, match="half"):
        write_half()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_there_or_comes_meanwhile_stays(tmp_path: Path) -> None:
    path = tmp_path / "export.zip"

    def write_beside_others() -> None:
        with new_file(path) as unfinished:
            unfinished.write_text("ours")
            path.write_text("theirs")

    with pytest.raises(FileExistsError, match="export"):
        write_beside_others()
    with pytest.raises(FileExistsError) as refused, new_file(path):
        pytest.fail("nothing is written")
    assert refused.value.strerror == "File exists"
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("code", [errno.EPERM, errno.EOPNOTSUPP])
def test_a_file_system_without_hard_links_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def refuse(_: Path, __: Path) -> None:
        raise OSError(code, "no links here")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    with new_file(tmp_path / "export.zip") as unfinished:
        unfinished.write_text("whole")
    assert (tmp_path / "export.zip").read_text() == "whole"
