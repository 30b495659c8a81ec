"""Reads the forms of the pages and refuses those sent by another site. Called by the pages that accept a POST."""

from collections.abc import Mapping
from urllib.parse import parse_qsl

from starlette.exceptions import HTTPException
from starlette.requests import Request

FORM_LIMIT_BYTES = 1 << 16
MEDIA_TYPE = "application/x-www-form-urlencoded"


async def read_form(request: Request) -> Mapping[str, str]:
    """Return the fields of a form sent by one of our own pages; of equal names the last one counts.

    Raises:
        HTTPException: 403 if another site sent it, 413 if it is too large, 415 if it is not a form.
    """
    require_same_site(request)
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != MEDIA_TYPE:
        raise HTTPException(415, f"Expected a form as {MEDIA_TYPE}, got {media_type or 'no content type'}.")
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > FORM_LIMIT_BYTES:
            raise HTTPException(
                413, f"Expected a form of at most {FORM_LIMIT_BYTES} bytes, got more. Send only its own fields."
            )
    return dict(parse_qsl(body.decode("utf-8", errors="replace"), keep_blank_values=True))


def require_same_site(request: Request) -> None:
    """Refuse a POST from another site, by Fetch metadata or else the Origin header.

    Raises:
        HTTPException: 403.
    """
    site = request.headers.get("sec-fetch-site")
    origin = request.headers.get("origin")
    foreign_site = site is not None and site not in {"same-origin", "none"}
    host = request.headers.get("host")
    foreign_origin = site is None and origin is not None and origin.partition("://")[2] != host
    if foreign_site or foreign_origin:
        raise HTTPException(403, "This form was sent from another site. Open the page here and send it again.")


def local_target(target: str) -> str:
    """Return the path to go to after signing in: `target` if it is on this site, else the submissions."""
    # Browsers read a backslash as a slash and leave out tabs and line ends.
    is_local = target.startswith("/") and not target.startswith("//") and "\\" not in target
    return target if is_local and target.isprintable() else "/submissions"
