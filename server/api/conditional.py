"""Answers that a client keeps and asks for again: 304 without the content where it has not changed (RFC 9110, 13)."""

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import Request, Response


def answer(request: Request, body: bytes, *, revision: str, media_type: str, headers: Mapping[str, str]) -> Response:
    """Return the body under an entity tag, or 304 where the client has this revision.

    The tag is weak: of equal revisions only what nobody compares may differ, such as when they were made.
    """
    tagged = {"ETag": f'W/"{revision}"', **headers}
    if _has(request, revision):
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=tagged)
    return Response(body, media_type=media_type, headers=tagged)


def _has(request: Request, revision: str) -> bool:
    tags = [tag.strip() for tag in request.headers.get("if-none-match", "").split(",")]
    return "*" in tags or any(tag.removeprefix("W/") == f'"{revision}"' for tag in tags)
