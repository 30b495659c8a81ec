"""Sharing a result: a team makes its submission public, others get a picture and a citation; clearing of copies."""

import asyncio
from dataclasses import dataclass
from hashlib import sha256

from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import load_track
from vitac.server.api.conditional import answer
from vitac.server.database.states import EvaluationState
from vitac.server.leaderboards import public_pages
from vitac.server.principals import VISITOR
from vitac.server.views.submissions import SubmissionView

from ...sharing.preview import Citation, cite, draw_preview
from ...site import Viewer, get_site, open_to_all
from ..addresses import as_id
from ..submission_detail import read_detail

KEPT_S = 300
"""So long others may show a picture without asking for it again [s]."""


@dataclass(frozen=True, kw_only=True)
class Shared:
    """How a submission is shared on its page.

    Attributes:
        address: of its page.
        may_change: whether the visitor decides who sees it.
        is_public: whether everybody sees it now.
        citation: of a complete one.
    """

    address: str
    may_change: bool
    is_public: bool
    citation: Citation | None


async def shared(request: Request, viewer: Viewer | None, view: SubmissionView, track: str) -> Shared:
    """Return how a submission of a track with that title is shared."""
    is_complete = view.evaluation.state is EvaluationState.COMPLETED
    site = get_site(request)
    address = f"{site.address(request)}/submissions/{view.id}"
    is_shown = (
        is_complete
        and view.public
        and view.id in await site.read(lambda session: public_pages.public_among(session, [view.id]))
    )
    return Shared(
        address=address,
        may_change=viewer is not None and viewer.may_change(view.team.name),
        is_public=is_shown,
        citation=cite(view, track, address) if is_complete else None,
    )


@open_to_all
async def preview(request: Request) -> Response:
    """Answer with the picture that a link to a public submission is shown with elsewhere; for everybody the same."""
    site, submission_id = get_site(request), as_id(request.path_params["submission_id"])
    detail = await site.read(lambda session: read_detail(session, site.services.settings, VISITOR, submission_id))
    view, title = detail.submission, load_track(detail.submission.track).title
    shown = f"{view.evaluation.id} {view.played_rank} {len(detail.episodes)} {view.name!r} {view.team.name!r}"
    picture = await asyncio.to_thread(
        site.previews.get, shown, lambda: draw_preview(view, title, detail.episodes, site.preview_font)
    )
    return answer(
        request,
        picture,
        revision=sha256(picture).hexdigest()[:32],
        media_type="image/png",
        headers={"Cache-Control": f"public, max-age={KEPT_S}", "Cross-Origin-Resource-Policy": "cross-origin"},
    )
