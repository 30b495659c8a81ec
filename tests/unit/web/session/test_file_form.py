import asyncio
from collections.abc import AsyncIterator, Callable, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import Message
from vitac.web.session import file_form
from vitac.web.session.file_form import FORM_LIMIT_BYTES, MAX_PARTS, FileForm, read_file_form

BOUNDARY = "----of-the-form"
TYPE = f"multipart/form-data; boundary={BOUNDARY}"


def part(name: str, content: bytes, file_name: str | None = None) -> bytes:
    named = "" if file_name is None else f'; filename="{file_name}"\r\nContent-Type: application/zip'
    head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"{named}\r\n\r\n'
    return head.encode() + content + b"\r\n"


def whole(*parts: bytes) -> bytes:
    return b"".join(parts) + f"--{BOUNDARY}--\r\n".encode()


def a_request(
    body: bytes, *, sizes: Callable[[], int] = lambda: 7, hangs: bool = False, headers: Mapping[str, str] | None = None
) -> Request:
    """A request whose body arrives in pieces; with `hangs` nothing follows it."""
    given_headers = {"content-type": TYPE, "sec-fetch-site": "same-origin", **(headers or {})}
    rest = body

    async def receive() -> Message:
        nonlocal rest
        if hangs and not rest:
            await asyncio.Event().wait()
        size = sizes()
        piece, rest = rest[:size], rest[size:]
        return {"type": "http.request", "body": piece, "more_body": bool(rest) or hangs}

    raw = [(name.encode(), value.encode()) for name, value in given_headers.items()]
    return Request({"type": "http", "method": "POST", "path": "/", "headers": raw}, receive)


async def content_of(form: FileForm) -> bytes:
    return b"".join([piece async for piece in form.pieces])


def read(request: Request) -> tuple[dict[str, str], str, bytes]:
    async def all_of_it() -> tuple[dict[str, str], str, bytes]:
        form = await read_file_form(request)
        return form.fields, form.file_name, await content_of(form)

    return asyncio.run(all_of_it())


@given(st.binary(max_size=500), st.integers(1, 300))
def test_fields_and_file_arrive_unchanged_in_pieces_of_any_size(content: bytes, size: int) -> None:
    # A boundary cannot be in the file, and what looks like one so far has to be kept.
    content += f"\r\n--{BOUNDARY[:-1]}".encode() + content
    body = whole(part("form_token", b"abc"), part("team", "Füchse".encode()), part("file", content, "mine.zip"))
    assert read(a_request(body, sizes=lambda: size)) == ({"form_token": "abc", "team": "Füchse"}, "mine.zip", content)


def test_the_file_is_not_read_before_it_is_asked_for() -> None:
    async def fields_only() -> FileForm:
        return await read_file_form(a_request(part("form_token", b"abc") + part("file", b"PK", "a.zip"), hangs=True))

    assert asyncio.run(fields_only()).fields == {"form_token": "abc"}


def test_never_more_than_a_chunk_is_held() -> None:
    content = bytes(1 << 20)

    async def largest() -> int:
        form = await read_file_form(a_request(whole(part("file", content, "a.zip")), sizes=lambda: 4096))
        return max([len(piece) async for piece in form.pieces])

    assert asyncio.run(largest()) <= 4096


def test_what_stands_after_the_file_does_not_count() -> None:
    body = whole(part("file", b"first", "a.zip"), part("form_token", b"late"), part("file", b"second", "b.zip"))
    assert read(a_request(body, sizes=lambda: 1000)) == ({}, "a.zip", b"first")


def test_no_file_is_an_empty_name() -> None:
    assert read(a_request(whole(part("form_token", b"abc")))) == ({"form_token": "abc"}, "", b"")
    assert read(a_request(whole(part("file", b"", "")))) == ({}, "", b"")


def test_a_form_that_ends_in_its_file_is_refused() -> None:
    body = part("file", b"PK" * 100, "a.zip")[:-20]
    with pytest.raises(HTTPException, match="ended before its file did") as caught:
        read(a_request(body))
    assert caught.value.status_code == 400


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"no boundary at all", 400),
        (whole(part("form_token", b"x" * (FORM_LIMIT_BYTES + 1)), part("file", b"PK", "a.zip")), 413),
        (whole(*(part(f"field {number}", b"x") for number in range(MAX_PARTS)), part("file", b"", "a.zip")), 413),
        (part("x" * 100_000, b""), 400),
        (whole(part("team", b"Gel\0bots"), part("file", b"PK", "a.zip")), 400),
        (whole(b"--" + BOUNDARY.encode() + b"\r\n" + b"X: y\r\n" * 1000 + b"\r\n"), 400),
    ],
)
def test_malformed_and_oversized_forms_are_refused(body: bytes, status: int) -> None:
    with pytest.raises(HTTPException) as caught:
        read(a_request(body, sizes=lambda: 1000))
    assert caught.value.status_code == status


@pytest.mark.parametrize(
    "content_type", ["", "text/plain", "multipart/form-data", "multipart/mixed; boundary=x", "application/zip"]
)
def test_what_is_no_such_form_is_refused(content_type: str) -> None:
    with pytest.raises(HTTPException, match="Expected a form as multipart/form-data") as caught:
        read(a_request(b"", headers={"content-type": content_type}))
    assert caught.value.status_code == 415


def test_a_boundary_that_is_too_long_is_refused() -> None:
    with pytest.raises(HTTPException, match="malformed"):
        read(a_request(b"", headers={"content-type": f"multipart/form-data; boundary={'b' * 1000}"}))


def test_another_sites_form_is_refused() -> None:
    with pytest.raises(HTTPException, match="another site"):
        read(a_request(b"", headers={"sec-fetch-site": "cross-site"}))


def test_fields_that_never_arrive_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_form, "FIELDS_TIMEOUT_S", 0.05)
    with pytest.raises(HTTPException, match="did not arrive within") as caught:
        read(a_request(part("form_token", b"abc"), hangs=True))
    assert caught.value.status_code == 408


def test_the_rest_is_discarded_but_not_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_form, "DISCARDED_BYTES", 10_000)
    monkeypatch.setattr(file_form, "DISCARD_TIMEOUT_S", 0.05)

    async def read_after_discarding(content: bytes, *, hangs: bool) -> int:
        body = whole(part("file", content, "a.zip"))
        form = await read_file_form(a_request(body, sizes=lambda: 1000, hangs=hangs))
        await form.discard()
        return len(await content_of(form))

    assert asyncio.run(read_after_discarding(bytes(9000), hangs=False)) == 0
    assert asyncio.run(read_after_discarding(bytes(50_000), hangs=False)) > 30_000
    assert asyncio.run(read_after_discarding(b"", hangs=True)) == 0


async def _never() -> AsyncIterator[bytes]:
    raise HTTPException(400, "cut")
    yield b""


def test_discarding_what_was_cut_is_no_error() -> None:
    asyncio.run(FileForm(fields={}, file_name="a.zip", pieces=_never()).discard())
