"""Headers of uploads in pieces, and the version that requests and answers name; without a service."""

import asyncio
import base64
import hashlib
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from vitac.server.api.uploads import VERSION, ProtocolVersion, http_date, read_checksum, read_metadata, read_number
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.submissions.pieces import CHECKSUMS


def request(method: str = "PATCH", path: str = "/uploads/1", **headers: str) -> Request:
    named = [(name.replace("_", "-").encode(), value.encode("latin-1")) for name, value in headers.items()]
    return Request({"type": "http", "method": method, "path": path, "headers": named, "query_string": b""})


def encoded(text: str | bytes) -> str:
    return base64.b64encode(text if isinstance(text, bytes) else text.encode()).decode()


@given(st.integers(0, 10**18 - 1))
def test_a_number_of_bytes_is_read(number: int) -> None:
    assert read_number(request(upload_offset=str(number)), "upload-offset") == number


@pytest.mark.parametrize("text", ["-1", "+1", "1.0", "1e3", "0x10", " ", "1 2", "\u00b2", "1" * 19, "9" * 5000])
def test_what_is_no_number_of_bytes_is_refused_with_its_beginning(text: str) -> None:
    with pytest.raises(ServiceError) as refused:
        read_number(request(upload_length=text), "Upload-Length")
    assert refused.value.code is ProblemCode.LENGTH_INVALID
    assert refused.value.detail == f"Expected Upload-Length in bytes, got {text[:40]!r}."


def test_a_missing_number_is_told() -> None:
    with pytest.raises(ServiceError, match=r"^Expected Upload-Offset in bytes, got 'none'\.$"):
        read_number(request(), "Upload-Offset")


@pytest.mark.parametrize(
    ("header", "found"),
    [
        (None, {}),
        ("", {}),
        (" , ,", {}),
        (f"filename {encoded('model.zip')}", {"filename": "model.zip"}),
        (f"filename {encoded('a')},name {encoded('b')}", {"filename": "a", "name": "b"}),
        (f"  filename   {encoded('a')}  ,  name {encoded('b')} ", {"filename": "a", "name": "b"}),
        ("is_confidential", {"is_confidential": ""}),
        (f"name {encoded('Täst, with a comma')}", {"name": "Täst, with a comma"}),
    ],
)
def test_metadata_are_names_with_values_in_base64(header: str | None, found: dict[str, str]) -> None:
    assert read_metadata(request() if header is None else request(upload_metadata=header)) == found


@pytest.mark.parametrize(
    "pair",
    [
        "name not-base64!",
        "name YQ",
        f"name {encoded(bytes([0xFF, 0xFE]))}",
        f"name {encoded('a' + chr(0) + 'b')}",
        "name YQ== YQ==",
        f"first {encoded('a')}",
        "name " + "!" * 5000,
    ],
)
def test_metadata_of_another_form_are_refused_with_the_pair(pair: str) -> None:
    with pytest.raises(ServiceError) as refused:
        read_metadata(request(upload_metadata=f"first {encoded('a')},{pair}"))
    assert refused.value.code is ProblemCode.INVALID_REQUEST
    assert refused.value.detail == f"Expected Upload-Metadata as `name base64,...`, got {pair!r:.80}."


NAMES = st.text("abc_", min_size=1, max_size=8)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)


@settings(max_examples=30)
@given(st.dictionaries(NAMES, TEXTS, max_size=4))
def test_any_text_survives_as_metadata(values: dict[str, str]) -> None:
    header = ",".join(f"{name} {encoded(value)}" for name, value in values.items())
    assert read_metadata(request(upload_metadata=header)) == values


@pytest.mark.parametrize("algorithm", ["sha256", "sha1"])
def test_a_checksum_is_read(algorithm: str) -> None:
    digest = hashlib.new(algorithm, b"piece").digest()
    found = read_checksum(request(upload_checksum=f"{algorithm} {encoded(digest)}"))
    assert found is not None
    assert (found.algorithm, found.digest) == (algorithm, digest)
    piece = CHECKSUMS[algorithm]()
    piece.update(b"piece")
    assert piece.digest() == digest


def test_a_piece_may_have_no_checksum() -> None:
    assert read_checksum(request()) is None


@pytest.mark.parametrize("given_", ["", "sha256", "sha256 ", "md5 YQ==", "SHA256 YQ==", "sha256 not-base64!", "YQ=="])
def test_a_checksum_of_another_form_is_refused(given_: str) -> None:
    with pytest.raises(ServiceError) as refused:
        read_checksum(request(upload_checksum=given_))
    assert refused.value.code is ProblemCode.INVALID_REQUEST
    assert refused.value.detail == f"Expected Upload-Checksum as `sha256|sha1 base64`, got {given_!r:.80}."


@pytest.mark.parametrize("hours", [-7, 0, 2])
def test_times_are_written_in_gmt_whatever_their_zone(hours: int) -> None:
    when = datetime(2025, 3, 1, 12, 30, 5, tzinfo=UTC).astimezone(timezone(timedelta(hours=hours)))
    assert http_date(when) == "Sat, 01 Mar 2025 12:30:05 GMT"


def ask(found: Request) -> tuple[int, dict[str, str], bytes]:
    """Send a request through the middleware to an application that says "reached"."""
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(ProtocolVersion(PlainTextResponse("reached"), "/uploads")(found.scope, receive, send))
    headers = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return sent[0]["status"], headers, b"".join(message.get("body", b"") for message in sent[1:])


@pytest.mark.parametrize("path", ["/uploads", "/uploads/1", "/uploads/1/2"])
def test_a_request_that_names_our_version_is_handed_on_and_the_answer_names_it(path: str) -> None:
    status, headers, body = ask(request(path=path, tus_resumable=VERSION))
    assert (status, body, headers["tus-resumable"]) == (200, b"reached", "1.0.0")


@pytest.mark.parametrize("path", ["/", "/uploads-of-others", "/health", "/v1/uploads"])
def test_other_paths_are_left_alone(path: str) -> None:
    status, headers, body = ask(request(path=path))
    assert (status, body) == (200, b"reached")
    assert "tus-resumable" not in headers


@pytest.mark.parametrize("method", ["OPTIONS", "GET"])
def test_questions_need_no_version(method: str) -> None:
    assert ask(request(method))[0] == 200


def test_the_request_that_makes_the_submission_needs_no_version() -> None:
    assert ask(request("POST", "/uploads/1/submission"))[0] == 200
    assert ask(request("POST", "/uploads/1/submissions"))[0] == 412


@pytest.mark.parametrize(("method", "named"), [("PATCH", None), ("POST", "0.2.2"), ("HEAD", "2.0.0"), ("DELETE", "")])
def test_a_request_of_another_version_is_refused_and_told_ours(method: str, named: str | None) -> None:
    headers = {} if named is None else {"tus_resumable": named}
    status, answered, body = ask(request(method, **headers))
    assert (status, answered["tus-version"], answered["tus-resumable"]) == (412, VERSION, VERSION)
    assert answered["connection"] == "close"
    assert b'"code":"wrong_protocol_version"' in body
    assert f"Expected the header Tus-Resumable: 1.0.0, got {named or 'none'!r}.".encode() in body
