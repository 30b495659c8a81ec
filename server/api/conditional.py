"""Answers that a client keeps and asks for again: 304 without the content where it has not changed (RFC 9110, 13).

Text among them is compressed. Answers with secrets of a session are not made here: their size would reveal them.
"""

import gzip
from collections.abc import Mapping
from functools import lru_cache
from http import HTTPStatus

from fastapi import Request, Response


def answer(request: Request, body: bytes, *, revision: str, media_type: str, headers: Mapping[str, str]) -> Response:
    """Return the body under an entity tag, or 304 where the client has this revision.

    The tag is weak: of equal revisions only what nobody compares may differ, such as when they were made.
    """
    tagged = {"ETag": f'W/"{revision}"', **headers}
    if _has(request, revision):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=tagged)
    if media_type.startswith("image/"):
        return Response(body, media_type=media_type, headers=tagged)
    return compressed(request.headers, body, media_type=media_type, headers=tagged)


def compressed(asked: Mapping[str, str], body: bytes, *, media_type: str, headers: Mapping[str, str]) -> Response:
    """Return the body as gzip to a client that takes that; `asked` are the headers of its request."""
    varies = ", ".join(filter(None, (headers.get("Vary"), "Accept-Encoding")))
    made = Response(body, media_type=media_type, headers={**headers, "Vary": varies})
    if "gzip" in asked.get("accept-encoding", ""):
        made.body = compress(body)
        made.headers["Content-Encoding"] = "gzip"
        made.headers["Content-Length"] = str(len(made.body))
    return made


@lru_cache(maxsize=64)
def compress(body: bytes) -> bytes:
    """Compress text; what many ask for is compressed once."""
    return gzip.compress(body, compresslevel=6, mtime=0)


def _has(request: Request, revision: str) -> bool:
    tags = [tag.strip() for tag in request.headers.get("if-none-match", "").split(",")]
    return "*" in tags or any(tag.removeprefix("W/") == f'"{revision}"' for tag in tags)
