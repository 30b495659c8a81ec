import gzip
from pathlib import Path

import pytest
from vitac.evaluator.logs.packing import UnpackFailed, UnpackProblem, open_log

CONTENT = b"".join(b"line %d\n" % n for n in range(10_000))


def read(path: Path, max_bytes: int = len(CONTENT)) -> bytes:
    with open_log(path, max_bytes) as stream:
        return stream.read()


TWO_PARTS = gzip.compress(CONTENT[:99]) + gzip.compress(CONTENT[99:])


@pytest.mark.parametrize("data", [CONTENT, gzip.compress(CONTENT), TWO_PARTS], ids=["plain", "gzip", "two gzips"])
def test_gives_the_same_bytes_packed_and_unpacked(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    assert read(path) == CONTENT
    with open_log(path) as stream:
        assert stream.readline() == b"line 0\n"


@pytest.mark.parametrize("data", [CONTENT, gzip.compress(CONTENT)], ids=["plain", "gzip"])
def test_one_byte_more_than_the_limit_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    with pytest.raises(UnpackFailed, match=f"at most {len(CONTENT) - 1} bytes") as refusal:
        read(path, len(CONTENT) - 1)
    assert refusal.value.problem is UnpackProblem.TOO_LARGE


@pytest.mark.parametrize(
    "data",
    [
        gzip.compress(CONTENT)[:-1],
        gzip.compress(CONTENT)[:500],
        b"\x1f\x8b" + bytes(range(100, 150)),
        gzip.compress(CONTENT)[:-4] + b"\0\0\0\0",
        gzip.compress(CONTENT) + b"more",
    ],
    ids=["one byte short", "cut off", "junk", "wrong length", "junk behind it"],
)
def test_damaged_gzip_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    with pytest.raises(UnpackFailed) as refusal:
        read(path)
    assert refusal.value.problem is UnpackProblem.DAMAGED


def test_empty_file_is_empty(tmp_path: Path) -> None:
    (tmp_path / "log").touch()
    assert read(tmp_path / "log") == b""
