"""What is announced of an upload is checked before its body is read."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from service_factories import make_settings
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.submissions.intake import (
    AnnouncedUpload,
    ReceivedFile,
    check_announced,
    check_digest,
    limit_idle_time,
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


def announced(n_bytes: int | None = None, sha256: str | None = None) -> AnnouncedUpload:
    return AnnouncedUpload(kind=SubmissionKind.MODEL, total_bytes=n_bytes, sha256=sha256)


@pytest.mark.parametrize("n_bytes", [None, 1, 99, 100])
def test_a_size_up_to_the_limit_may_be_announced(n_bytes: int | None) -> None:
    check_announced(announced(n_bytes, "0a" * 32), 100)


@pytest.mark.parametrize(
    ("upload", "code", "message"),
    [
        (
            announced(101),
            ProblemCode.UPLOAD_TOO_LARGE,
            "This upload may have at most 100 bytes; 101 were announced. Make it smaller.",
        ),
        (
            announced(0),
            ProblemCode.UPLOAD_TRUNCATED,
            "The upload is empty, expected at least one byte. Check the file, and send it again.",
        ),
        *(
            (announced(5, sha256), ProblemCode.INVALID_REQUEST, f"Expected the SHA-256 as 64 hex digits, got {text}.")
            for sha256, text in [
                ("0" * 63, repr("0" * 63)),
                ("g" * 64, repr("g" * 64)),
                ("", "''"),
                ("0A" * 32, repr("0A" * 32)),
            ]
        ),
    ],
)
def test_what_cannot_be_an_upload_is_refused_before_anything_is_read(
    upload: AnnouncedUpload, code: ProblemCode, message: str
) -> None:
    with pytest.raises(ServiceError) as refusal:
        check_announced(upload, 100)
    assert (refusal.value.code, refusal.value.detail) == (code, message)


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


def test_another_digest_is_refused_with_both(tmp_path: Path) -> None:
    received = ReceivedFile(path=tmp_path, sha256="1" * 64, n_bytes=5)
    check_digest(received, None)
    check_digest(received, "1" * 64)
    with pytest.raises(ServiceError) as refusal:
        check_digest(received, "0" * 64)
    assert refusal.value.code is ProblemCode.DIGEST_MISMATCH
    assert refusal.value.extras == {"received_sha256": "1" * 64}
    assert refusal.value.detail == f"Expected SHA-256 {'0' * 64}, got 5 bytes with {'1' * 64}. Send again."


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
