import gzip
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.evaluator.logs.log import MAX_UNPACKED_BYTES, UnpackFailed, UnpackProblem, open_log

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


def test_codes_of_problems_are_those_that_the_api_promises() -> None:
    assert {problem.name: problem.value for problem in UnpackProblem} == {
        "DAMAGED": "damaged",
        "TOO_LARGE": "too_large",
    }


def test_the_largest_log_has_256_mib() -> None:
    assert MAX_UNPACKED_BYTES == 256 * 1024 * 1024


def test_a_refusal_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(gzip.compress(CONTENT)[:500])
    with pytest.raises(UnpackFailed) as damaged:
        read(path)
    cause = damaged.value.__cause__
    assert isinstance(cause, EOFError)
    assert str(damaged.value) == f"The gzip data is truncated or corrupt: {cause}. Compress the log again."
    path.write_bytes(CONTENT)
    with pytest.raises(UnpackFailed) as too_large:
        read(path, 10)
    assert str(too_large.value) == "Expected at most 10 bytes of uncompressed log, got more."


def test_a_bomb_is_refused_long_before_it_is_unpacked(tmp_path: Path) -> None:
    """A thousand bytes that become a million are read in steps, so no more than one step too many is unpacked."""
    path = tmp_path / "log"
    path.write_bytes(gzip.compress(bytes(1 << 20)))
    assert path.stat().st_size < 2000
    with open_log(path, 1000) as stream, pytest.raises(UnpackFailed, match="at most 1000 bytes"):
        stream.readline()


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "gzip"])
def test_lines_are_read_one_by_one_and_the_file_is_closed(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "log"
    path.write_bytes(pack(b"one\ntwo\nthree"))
    with open_log(path) as stream:
        assert [line.strip() for line in stream] == [b"one", b"two", b"three"]
        assert stream.readable()
        assert stream.read(1) == b""
    assert path.rename(tmp_path / "moved").exists()


@settings(max_examples=20)
@given(st.binary(max_size=300), st.integers(1, 50))
def test_a_stream_gives_its_bytes_in_pieces_of_any_size(content: bytes, size: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        path.write_bytes(gzip.compress(content))
        with open_log(path, len(content)) as stream:
            assert b"".join(iter(lambda: stream.read(size), b"")) == content


def test_a_file_that_begins_like_gzip_by_one_byte_only_is_plain(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(b"\x1fplain")
    assert read(path) == b"\x1fplain"
