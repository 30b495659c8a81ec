"""What all pages share: data, signer, the visitor of a request, and answers made from templates."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import wraps
from hashlib import sha256
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import quote

from starlette.exceptions import HTTPException
from starlette.responses import HTMLResponse, RedirectResponse
from vitac.envs.errors import VitacError
from vitac.server.api.conditional import answer
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.kept import Kept

from .fragments import Fragments, Recent
from .rendering import render
from .session.forms import read_form
from .session.signer import COOKIE

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable, Mapping
    from pathlib import Path

    from starlette.requests import Request
    from starlette.responses import Response

    from .data.front import Front
    from .data.protocol import PageData, Visitor
    from .plots.map import EpisodeMap
    from .session.signer import SessionSigner

    Page = Callable[[Request], Awaitable[Response]]

HTML = "text/html"
FRONT_KEPT_S = 5.0
"""The front page is asked for most, and reads the boards of all tracks."""
MAX_PLOTS = 256
"""Those of an evaluation or a board have up to 200 kB."""
MAX_MAPS = 128
"""That of a task has up to 200 kB."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """The pages of one server.

    Attributes:
        data: data of the pages.
        signer: signs the sessions.
        version: the distribution's version, shown in the footer.
        tracks: names of the tracks; the navigation leads to the first one.
        public_url: address that people use; None: that of the request.
        preview_font: font file for names in pictures of links.
        fragments: parts of pages as they were last rendered.
        plots: of evaluations and boards.
        maps: of episodes of complete evaluations.
        front: what the front page shows.
        previews: pictures that links to submissions are shown with.
    """

    data: PageData
    signer: SessionSigner
    version: str
    tracks: tuple[str, ...]
    public_url: str | None = None
    preview_font: Path | None = None
    fragments: Fragments = field(default_factory=Fragments)
    plots: Fragments = field(default_factory=lambda: Fragments(at_most=MAX_PLOTS))
    maps: Kept[Hashable, EpisodeMap] = field(default_factory=lambda: Kept(at_most=MAX_MAPS))
    front: Recent[Front] = field(default_factory=lambda: Recent(kept_s=FRONT_KEPT_S))
    previews: Kept[str, bytes] = field(default_factory=lambda: Kept(at_most=MAX_PLOTS))

    def address(self, request: Request) -> str:
        """Return the address to use on the command line."""
        return (self.public_url or str(request.base_url)).rstrip("/")


@dataclass(frozen=True, kw_only=True)
class Viewer:
    """The signed-in visitor as templates see it."""

    visitor: Visitor
    form_token: str

    @property
    def name(self) -> str:
        """The team's name, or the organizer's label."""
        return self.visitor.name

    @property
    def own_names(self) -> frozenset[str]:
        """The names under which the own team may be on boards."""
        return self.visitor.own_names

    @property
    def is_organizer(self) -> bool:
        """Whether all teams' submissions are shown."""
        return self.visitor.is_organizer

    @property
    def organizes_something(self) -> bool:
        """Whether all teams' submissions to one competition, or to all, are shown."""
        return self.visitor.principal.organizes_something

    def may_see(self, team: str, contest: str | None = None) -> bool:
        """Return whether the submissions of a team are shown; `contest`: those to a competition."""
        return self.visitor.may_see(team) or self.visitor.principal.organizes(contest or "")

    def may_change(self, team: str) -> bool:
        """Return whether the submissions of a team may be changed."""
        return self.is_organizer or self.name == team


@dataclass(frozen=True, kw_only=True)
class Tab:
    """A link to one of several pages that belong together."""

    title: str
    target: str
    current: bool


def site_of(request: Request) -> Site:
    """Return the site that `routes.install` stored in the application."""
    return cast("Site", request.app.state.site)


async def viewer_of(request: Request) -> Viewer | None:
    """Return the signed-in visitor, or None; a session ends with its token."""
    site = site_of(request)
    cookie = request.cookies.get(COOKIE)
    found = site.signer.read(cookie, now=datetime.now(UTC))
    if cookie is None or found is None:
        return None
    visitor = await site.data.visitor_with_token_id(found.token_id)
    return None if visitor is None else Viewer(visitor=visitor, form_token=site.signer.form_token(cookie))


def visitor_of(viewer: Viewer | None) -> Visitor | None:
    """Return a signed-in visitor as the data of the pages know them."""
    return None if viewer is None else viewer.visitor


class SignInNeeded(VitacError):
    """Only who is signed in sees this; the answer leads to the sign-in page."""


async def require_viewer(request: Request) -> Viewer:
    """Return the signed-in visitor.

    Raises:
        SignInNeeded: nobody is signed in.
    """
    viewer = await viewer_of(request)
    if viewer is None:
        raise SignInNeeded
    return viewer


def sign_in_first(request: Request, _: Exception) -> RedirectResponse:
    """Answer `SignInNeeded` with a redirect to the sign-in page, which leads back."""
    return RedirectResponse(f"/sign-in?next={quote(request.url.path)}", status_code=303)


def open_to_all(show: Page) -> Page:
    """Make a page one that also those see who are not signed in, where there is something public for them.

    What is not public, or not there, leads them to the sign-in page: nobody learns which of the two it is.
    """

    @wraps(show)
    async def shown(request: Request) -> Response:
        try:
            return await show(request)
        except ServiceError as error:
            if error.code is ProblemCode.MISSING_CREDENTIALS:
                raise SignInNeeded from error
            raise

    return shown


def require_form_token(request: Request, fields: Mapping[str, str], viewer: Viewer) -> None:
    """Refuse a form that was not made for this session.

    Raises:
        HTTPException: 403.
    """
    token = fields.get("form_token", "")
    if not site_of(request).signer.accepts_form_token(request.cookies.get(COOKIE), token):
        message = f"This form does not belong to {viewer.name}'s current session. Reload the page and try again."
        raise HTTPException(403, message)


async def signed_in_form(request: Request) -> tuple[Viewer, Mapping[str, str]]:
    """Return who sent a form, and its fields.

    Raises:
        SignInNeeded: nobody is signed in.
        HTTPException: it was not sent by a page of this session.
    """
    viewer = await require_viewer(request)
    fields = await read_form(request)
    require_form_token(request, fields, viewer)
    return viewer, fields


def page(
    request: Request, template: str, *, viewer: Viewer | None, section: str = "", status: int = 200, **values: Any
) -> Response:
    """Answer with a page; pages of a signed-in visitor are not cached.

    With `viewer_known=False` among the values, the header offers neither to sign in nor to sign out.
    """
    site = site_of(request)
    html = render(
        template,
        request,
        viewer=viewer,
        section=section,
        navigation=navigation(site, viewer),
        version=site.version,
        address=site.address(request),
        registration=site.data.registration().value,
        **{"viewer_known": True, **values},
    )
    if viewer is not None:
        return HTMLResponse(html, status_code=status, headers={"Cache-Control": "no-store", "Vary": "Cookie"})
    headers = {"Cache-Control": "no-cache", "Vary": "Cookie"}
    if status != HTTPStatus.OK:
        return HTMLResponse(html, status_code=status, headers=headers)
    body = html.encode()
    return answer(request, body, revision=sha256(body).hexdigest()[:32], media_type=HTML, headers=headers)


def navigation(site: Site, viewer: Viewer | None) -> tuple[tuple[str, str], ...]:
    """Return targets and labels of the navigation."""
    links = [(f"/tracks/{site.tracks[0]}", "Leaderboard"), (f"/tracks/{site.tracks[0]}/rules", "Rules")]
    if viewer is not None:
        links.append(("/submissions", "Submissions"))
        if viewer.visitor.has_team:
            links.append(("/team", "Team"))
        if viewer.visitor.principal.reads_all_teams or viewer.organizes_something:
            links.append(("/judging", "Judging"))
        if viewer.is_organizer:
            links += [("/desk", "Desk"), ("/operations", "Operations")]
        elif viewer.organizes_something:
            links += [("/appeals", "Appeals"), ("/rejudging", "Rejudging")]
    return tuple(links)
