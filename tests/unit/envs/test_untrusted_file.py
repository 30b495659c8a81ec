import os
import socket
from pathlib import Path

import pytest
from vitac.envs.untrusted_file import find_spelling, read_start


def test_content_is_read_up_to_one_byte_past_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_start(path, 5) == b"12345"
    assert read_start(path, 3) == b"1234"


def test_empty_file_has_no_content(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert read_start(tmp_path / "file", 10) == b""


def test_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="no regular file"):
        read_start(tmp_path / "pipe", 10)


def test_link_to_a_device_is_refused(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("/dev/zero")
    with pytest.raises(OSError, match="no regular file"):
        read_start(tmp_path / "link", 10)


def test_socket_is_refused(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        with pytest.raises(OSError, match=r".+"):
            read_start(tmp_path / "socket", 10)


def test_folder_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="is a folder"):
        read_start(tmp_path, 10)


def test_missing_file_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_start(tmp_path / "missing", 10)


def test_no_descriptor_is_left_open(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        with pytest.raises(OSError, match="no regular file"):
            read_start(tmp_path / "pipe", 10)
    assert len(list(Path("/proc/self/fd").iterdir())) <= before


def test_a_file_is_found_in_any_capitals(tmp_path: Path) -> None:
    (tmp_path / "Gel.STL").touch()
    assert find_spelling(tmp_path, "gel.stl") == tmp_path / "Gel.STL"
    (tmp_path / "gel.stl").touch()
    assert find_spelling(tmp_path, "gel.stl") == tmp_path / "gel.stl"
    assert find_spelling(tmp_path / "absent", "gel.stl") == tmp_path / "absent" / "gel.stl"
