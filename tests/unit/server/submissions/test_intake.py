"""A body is counted, hashed and bounded while it arrives, and leaves nothing behind when it is refused."""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from service_factories import make_settings
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.submissions.intake import (
    FILE_NAME,
    ReceivedFile,
    check_announced_size,
    check_digest,
    limit_idle_time,
    receive,
    upload_folder,
)

ResultT = TypeVar("ResultT")


async def body(*chunks: bytes, then_waits: bool = False) -> AsyncIterator[bytes]:
    for chunk in chunks:
        yield chunk
    if then_waits:
        await asyncio.Event().wait()


def run(work: Coroutine[Any, Any, ResultT]) -> ResultT:
    return asyncio.run(work)


def received(folder: Path, *chunks: bytes, limit_bytes: int = 100, announced_bytes: int | None = None) -> ReceivedFile:
    return run(
        receive(body(*chunks), folder, limit_bytes=limit_bytes, idle_timeout_s=5.0, announced_bytes=announced_bytes)
    )


def refused(folder: Path, *chunks: bytes, **options: int) -> ServiceError:
    with pytest.raises(ServiceError) as found:
        received(folder, *chunks, **options)
    return found.value


@pytest.mark.parametrize("chunks", [(b"whole",), (b"wh", b"ole"), (b"", b"w", b"", b"hole", b"")])
def test_a_body_is_on_disk_with_its_size_and_digest(tmp_path: Path, chunks: tuple[bytes, ...]) -> None:
    found = received(tmp_path, *chunks, announced_bytes=5)
    assert (found.path, found.n_bytes) == (tmp_path / FILE_NAME, 5)
    assert found.path.read_bytes() == b"whole"
    assert found.sha256 == hashlib.sha256(b"whole").hexdigest()


def test_a_body_may_be_as_large_as_the_limit_and_no_larger(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert received(tmp_path, b"x" * 100).n_bytes == 100
    error = refused(tmp_path / "other", b"x" * 60, b"x" * 41)
    assert error.code is ProblemCode.UPLOAD_TOO_LARGE
    assert error.extras == {"limit_bytes": 100}
    assert error.detail == "An upload of this kind may have at most 100 bytes; more were sent. Make it smaller."


def test_what_is_beyond_the_limit_is_not_written(tmp_path: Path) -> None:
    refused(tmp_path, b"x" * 90, b"y" * 1000, b"never read")
    assert (tmp_path / FILE_NAME).stat().st_size <= 90


@pytest.mark.parametrize(
    ("chunks", "announced", "message"),
    [
        ((), 3, "expected 3, got 0 bytes"),
        ((b"abc",), 4, "expected 4, got 3 bytes"),
        ((b"abc",), 2, "expected 2, got 3 bytes"),
    ],
)
def test_a_body_that_is_not_the_announced_one_is_cut(
    tmp_path: Path, chunks: tuple[bytes, ...], announced: int | None, message: str
) -> None:
    with pytest.raises(ServiceError) as found:
        received(tmp_path, *chunks, announced_bytes=announced)
    assert found.value.code is ProblemCode.UPLOAD_TRUNCATED
    assert found.value.detail == (
        f"The upload ended early: {message}. Send it again; a resumable upload continues where it ended."
    )


@pytest.mark.parametrize(("chunks", "announced"), [((), None), ((b"",), None), ((), 0)])
def test_an_empty_body_is_told_as_such(tmp_path: Path, chunks: tuple[bytes, ...], announced: int | None) -> None:
    with pytest.raises(ServiceError, match=r"The upload is empty, expected at least one byte\.") as found:
        received(tmp_path, *chunks, announced_bytes=announced)
    assert found.value.code is ProblemCode.UPLOAD_TRUNCATED


@pytest.mark.parametrize("n_bytes", [None, 0, 99, 100])
def test_a_size_up_to_the_limit_may_be_announced(n_bytes: int | None) -> None:
    check_announced_size(n_bytes, 100)


def test_a_larger_size_is_refused_before_anything_is_read() -> None:
    with pytest.raises(ServiceError) as found:
        check_announced_size(101, 100)
    assert found.value.code is ProblemCode.UPLOAD_TOO_LARGE
    assert found.value.detail == (
        "An upload of this kind may have at most 100 bytes; 101 bytes were announced. Make it smaller."
    )


@settings(max_examples=25)
@given(st.lists(st.binary(max_size=8), max_size=8))
def test_chunks_are_passed_on_but_for_empty_ones(chunks: list[bytes]) -> None:
    async def collected() -> list[bytes]:
        return [chunk async for chunk in limit_idle_time(body(*chunks), 5.0)]

    assert run(collected()) == [chunk for chunk in chunks if chunk]


@pytest.mark.parametrize("before", [(), (b"some",)])
def test_a_body_that_stays_away_is_cut(before: tuple[bytes, ...]) -> None:
    async def collected() -> None:
        async for chunk in limit_idle_time(body(*before, then_waits=True), 0.01):
            assert chunk in before

    with pytest.raises(ServiceError, match=r"The upload ended early: nothing was sent for 0\.01 s\.") as found:
        run(collected())
    assert found.value.code is ProblemCode.UPLOAD_TRUNCATED


def test_a_digest_is_compared_whatever_its_case(tmp_path: Path) -> None:
    found = received(tmp_path, b"whole")
    for claimed in (None, found.sha256, found.sha256.upper()):
        check_digest(found, claimed)


@pytest.mark.parametrize("claimed", ["0" * 64, "", "not a digest", "0" * 5000])
def test_another_digest_is_refused_with_both(tmp_path: Path, claimed: str) -> None:
    found = received(tmp_path, b"whole")
    with pytest.raises(ServiceError) as error:
        check_digest(found, claimed)
    assert error.value.code is ProblemCode.DIGEST_MISMATCH
    assert error.value.extras == {"received_sha256": found.sha256}
    expected = f"Expected SHA-256 {claimed[:80]}, got 5 bytes with {found.sha256}. Send again."
    assert error.value.detail == expected


def test_a_folder_is_private_and_gone_with_what_it_holds(tmp_path: Path) -> None:
    settings_ = make_settings(state_dir=tmp_path)
    with upload_folder(settings_) as first, upload_folder(settings_) as second:
        assert first != second
        assert first.parent == settings_.scratch_dir
        assert oct(first.stat().st_mode & 0o777) == "0o700"
        (first / "inside").mkdir()
        (first / "inside" / "file").write_text("x")
    assert not first.exists()
    assert settings_.scratch_dir.is_dir()


def test_a_folder_is_gone_after_a_refusal_too(tmp_path: Path) -> None:
    with pytest.raises(ServiceError), upload_folder(make_settings(state_dir=tmp_path)) as folder:
        received(folder)
    assert not folder.exists()
