"""Sign in with an API token, and sign out."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from starlette.responses import RedirectResponse

from ...session import signer
from ...session.forms import local_target, read_form
from ...site import page, require_form_token, site_of, viewer_of

if TYPE_CHECKING:
    from uuid import UUID

    from starlette.requests import Request
    from starlette.responses import Response

WRONG_TOKEN = "This token is unknown, revoked or expired. Check that you pasted it completely."  # noqa: S105 - a sentence


async def sign_in_form(request: Request) -> Response:
    """Show the sign-in form."""
    target = local_target(request.query_params.get("next", ""))
    return page(request, "sign_in.html", viewer=await viewer_of(request), section="/sign-in", next=target, wrong=None)


async def sign_in(request: Request) -> Response:
    """Check the token and begin a session."""
    fields = await read_form(request)
    site = site_of(request)
    target = local_target(fields.get("next", ""))
    visitor = await site.data.visitor_with_token(fields.get("token", "").strip())
    if visitor is None:
        return page(
            request, "sign_in.html", viewer=None, section="/sign-in", status=401, next=target, wrong=WRONG_TOKEN
        )
    answer = RedirectResponse(target, status_code=303)
    begin_session(request, answer, visitor.token_id)
    return answer


def begin_session(request: Request, answer: Response, token_id: UUID) -> None:
    """Let the browser be signed in with a token from this answer on."""
    answer.set_cookie(
        signer.COOKIE,
        site_of(request).signer.sign(signer.begin(token_id, now=datetime.now(UTC))),
        max_age=int(signer.LIFETIME.total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


async def sign_out(request: Request) -> Response:
    """End the session."""
    fields = await read_form(request)
    viewer = await viewer_of(request)
    if viewer is not None:
        require_form_token(request, fields, viewer)
    answer = RedirectResponse("/", status_code=303)
    answer.delete_cookie(signer.COOKIE, httponly=True, samesite="strict", secure=request.url.scheme == "https")
    return answer
