import gzip

from fastapi import Request
from vitac.server.api.conditional import answer

BODY = b"many of one kind " * 100


def asked(**headers: str) -> Request:
    named = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return Request({"type": "http", "method": "GET", "path": "/", "headers": named})


def test_text_is_compressed_for_a_client_that_takes_that_and_stays_what_it_is() -> None:
    headers = {"Vary": "Cookie"}
    plain = answer(asked(), BODY, revision="1", media_type="text/html", headers=headers)
    small = answer(asked(accept_encoding="br, gzip"), BODY, revision="1", media_type="text/html", headers=headers)
    assert (plain.body, gzip.decompress(small.body)) == (BODY, BODY)
    assert int(small.headers["content-length"]) == len(small.body) < len(BODY) / 10
    assert plain.headers["vary"] == small.headers["vary"] == "Cookie, Accept-Encoding"
    assert small.headers["etag"] == 'W/"1"'


def test_a_picture_is_not_compressed_again() -> None:
    found = answer(asked(accept_encoding="gzip"), BODY, revision="1", media_type="image/png", headers={})
    assert found.body == BODY


def test_what_the_client_has_is_not_sent() -> None:
    found = answer(asked(if_none_match='"0", W/"1"'), BODY, revision="1", media_type="text/html", headers={})
    assert (found.status_code, found.body) == (304, b"")
