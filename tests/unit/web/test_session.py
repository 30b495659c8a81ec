import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from uuid import UUID

import pytest
from asgi_browser import AsgiBrowser
from hypothesis import given
from hypothesis import strategies as st
from seeded_site import GELBOTS, SeededSite, form_token
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import Message
from vitac.web import session
from vitac.web.session import (
    FORM_LIMIT_BYTES,
    MAX_PARTS,
    FileForm,
    SessionSigner,
    load_key,
    local_target,
    read_file_form,
)

NOW = datetime(2026, 11, 21, 3, 0, tzinfo=UTC)
SIGNER = SessionSigner(key=b"k" * 32)
TOKEN = UUID("6f1f6c1e-2a54-4f0e-8a43-94a4a8a0a001")
OTHER = UUID("6f1f6c1e-2a54-4f0e-8a43-94a4a8a0a002")


def test_reads_back_what_it_signed() -> None:
    begun = session.begin(TOKEN, now=NOW)
    assert SIGNER.read(SIGNER.sign(begun), now=NOW) == begun


def test_session_is_over_at_its_expiry() -> None:
    begun = session.begin(TOKEN, now=NOW)
    cookie = SIGNER.sign(begun)
    last_moment = NOW + session.LIFETIME - timedelta(seconds=1)
    assert SIGNER.read(cookie, now=last_moment) == begun
    assert SIGNER.read(cookie, now=NOW + session.LIFETIME) is None


@pytest.mark.parametrize(
    "cookie", [None, "", "x", "...", "token-1.99999999999.", "token-1.99999999999.00ff", "ümlaut.1.é"]
)
def test_refuses_a_cookie_that_it_did_not_sign(cookie: str | None) -> None:
    assert SIGNER.read(cookie, now=NOW) is None


def test_refuses_another_servers_cookie() -> None:
    foreign = SessionSigner(key=b"x" * 32).sign(session.begin(TOKEN, now=NOW))
    assert SIGNER.read(foreign, now=NOW) is None


def test_refuses_a_longer_expiry_under_an_old_signature() -> None:
    token_id, expiry, mac = SIGNER.sign(session.begin(TOKEN, now=NOW)).split(".")
    assert SIGNER.read(f"{token_id}.{int(expiry) + 1}.{mac}", now=NOW) is None


@given(st.text(max_size=80))
def test_never_reads_a_made_up_cookie(cookie: str) -> None:
    assert SIGNER.read(cookie, now=NOW) is None


def test_form_token_belongs_to_one_session() -> None:
    mine, other = (SIGNER.sign(session.begin(token, now=NOW)) for token in (TOKEN, OTHER))
    assert SIGNER.accepts_form_token(mine, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(other, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(None, SIGNER.form_token(mine))
    assert not SIGNER.accepts_form_token(mine, "")


def test_form_token_is_not_a_session_signature() -> None:
    cookie = SIGNER.sign(session.begin(TOKEN, now=NOW))
    assert SIGNER.form_token(cookie) not in cookie


def test_a_device_is_known_for_its_member_until_it_expires() -> None:
    cookie = SIGNER.sign_device("owls\neve", now=NOW)
    assert SIGNER.read_device(cookie, "owls\neve", now=NOW) == cookie.partition(".")[0]
    late = NOW + session.DEVICE_LIFETIME
    for other, member, now in (
        (cookie, "owls\nann", NOW),
        (cookie, "owls\neve", late),
        (f"{cookie}0", "owls\neve", NOW),
    ):
        assert SIGNER.read_device(other, member, now=now) is None
    assert SIGNER.read_device(None, "owls\neve", now=NOW) is None


def test_makes_the_key_once_and_keeps_it_private(tmp_path: Path) -> None:
    path = tmp_path / "state" / "session.key"
    first = load_key(path)
    assert len(first) == session.KEY_BYTES
    assert load_key(path) == first
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(path.parent.iterdir()) == [path]


def test_two_servers_that_start_at_once_agree_on_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "session.key"
    first = load_key(path)
    # The second one looked before the first had written.
    monkeypatch.setattr(Path, "exists", lambda _: False)
    assert load_key(path) == first


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
    monkeypatch.setattr(session, "FIELDS_TIMEOUT_S", 0.05)
    with pytest.raises(HTTPException, match="did not arrive within") as caught:
        read(a_request(part("form_token", b"abc"), hangs=True))
    assert caught.value.status_code == 408


def test_the_rest_is_discarded_but_not_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "DISCARDED_BYTES", 10_000)
    monkeypatch.setattr(session, "DISCARD_TIMEOUT_S", 0.05)

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


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "", "origin": "https://evil.test"},
    ],
)
def test_forms_of_other_sites_are_refused(site: SeededSite, headers: dict[str, str]) -> None:
    browser = site.visitor(GELBOTS)
    for path in ("/sign-in", "/sign-out", "/register", f"{site.path_of('runs')}/cancel"):
        answer = browser.post(path, data={"form_token": form_token(browser)}, headers=headers)
        assert answer.status_code == 403
        assert "another site" in answer.text


def test_a_form_that_is_none_is_refused_and_told_what_was_expected(browser: AsgiBrowser) -> None:
    other = browser.post("/sign-in", json={"token": "x"})
    assert (other.status_code, "got application/json" in other.text) == (415, True)
    empty = browser.post("/sign-in")
    assert (empty.status_code, "got no content type" in empty.text) == (415, True)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"origin": "http://testserver"}, 303),
        ({"sec-fetch-site": "none"}, 303),
        ({}, 303),  # as of a command-line client, which no other site can start
        *(
            ({"origin": origin}, 403)
            for origin in ("null", "https://testserver.evil.test", "http://[", "testserver", "")
        ),
    ],
)
def test_browsers_that_tell_less_are_believed_by_their_origin(
    site: SeededSite, headers: dict[str, str], status: int
) -> None:
    browser = site.visitor(headers=headers)
    assert browser.post("/sign-in", data={"token": site.token_of(GELBOTS)}).status_code == status


@pytest.mark.parametrize(("bytes_beyond", "status"), [(0, 401), (1, 413)])
def test_a_form_may_be_as_long_as_the_limit(browser: AsgiBrowser, bytes_beyond: int, status: int) -> None:
    token = "x" * (FORM_LIMIT_BYTES - len("token=") + bytes_beyond)
    assert browser.post("/sign-in", data={"token": token}).status_code == status


def test_a_media_type_with_parameters_and_capitals_is_a_form_whose_last_field_of_a_name_counts(
    site: SeededSite, browser: AsgiBrowser
) -> None:
    media_type = {"content-type": "Application/X-WWW-Form-Urlencoded; charset=utf-8"}
    for tokens, status in (("token=wrong&token={}", 303), ("token={}&token=wrong", 401), ("token=\xff%ff%00", 401)):
        content = tokens.format(site.token_of(GELBOTS)).encode("latin-1")
        assert browser.post("/sign-in", content=content, headers=media_type).status_code == status


@pytest.mark.parametrize("target", ["/", "/submissions/1?refresh=off#top", "/tracks/track_1?task=a//b", "/x?y=["])
def test_a_path_of_this_site_is_kept(target: str) -> None:
    assert local_target(target) == target


@pytest.mark.parametrize(
    "target", ["//[", "http://[", "///evil.test", "/\t/evil.test", "/\n/evil.test", "/a\\b", " /x", "/\x00", "/\u202e"]
)
def test_what_a_browser_might_take_for_another_site_is_not_kept(target: str) -> None:
    assert local_target(target) == "/submissions"


def test_a_damaged_target_does_not_break_the_sign_in_page(browser: AsgiBrowser) -> None:
    assert browser.get("/sign-in?next=//[").status_code == 200
