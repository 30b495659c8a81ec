"""What all pages share: the service, the signer, the visitor of a request, and answers made from templates."""

import asyncio
from collections.abc import Awaitable, Callable, Hashable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import wraps
from hashlib import sha256
from http import HTTPStatus
from pathlib import Path
from typing import Any, TypeVar, cast
from urllib.parse import quote

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from vitac.errors import VitacError
from vitac.server.accounts import tokens
from vitac.server.api.conditional import answer
from vitac.server.cache import Cache
from vitac.server.competitions.view import competition_list_view
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.limiter import WindowLimiter
from vitac.server.principals import VISITOR, Principal
from vitac.server.services import Services
from vitac.server.views.competition import CompetitionSummaryView

from .front import FrontPage, Recent
from .plots.map import EpisodeMap
from .rendering import render
from .session import COOKIE, SessionSigner, read_form

Page = Callable[[Request], Awaitable[Response]]

ResultT = TypeVar("ResultT")
HTML = "text/html"
PAGE_TIMEOUT_S = 20.0
"""Time after which a page says that the database does not answer; its statements end before."""
FRONT_KEPT_S = 5.0
"""The front page is asked for most, and reads the boards of all tracks. What all pages say is read as seldom."""
COMPETITION = "/competition"
"""Address of the competition that opened last, and the section of the pages of all competitions."""
MAX_PLOTS = 256
"""Number of cached plots; those of an evaluation or a board have up to 200 kB."""
MAX_MAPS = 128
"""Number of cached maps; that of a task has up to 200 kB."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """The pages of one server.

    Attributes:
        services: database, files and settings.
        playbacks: counts the playbacks that visitors ask for, by their address.
        signer: signs the sessions.
        version: the distribution's version, shown in the footer.
        tracks: names of the tracks; the navigation leads to the first one.
        public_url: address that people use; None: that of the socket, which only this machine reaches.
        preview_font: font file for names in pictures of links.
        plots: of evaluations and boards.
        maps: of episodes of complete evaluations.
        front: what the front page shows.
        competitions: of the service, the one that opened last first; the header leads to them.
        previews: pictures that links to submissions are shown with.
    """

    services: Services
    playbacks: WindowLimiter
    signer: SessionSigner
    version: str
    tracks: tuple[str, ...]
    public_url: str | None = None
    preview_font: Path | None = None
    plots: Cache[Hashable, Any] = field(default_factory=lambda: Cache(at_most=MAX_PLOTS))
    maps: Cache[Hashable, EpisodeMap] = field(default_factory=lambda: Cache(at_most=MAX_MAPS))
    front: Recent[FrontPage] = field(default_factory=lambda: Recent(kept_s=FRONT_KEPT_S))
    competitions: Recent[Sequence[CompetitionSummaryView]] = field(default_factory=lambda: Recent(kept_s=FRONT_KEPT_S))
    previews: Cache[str, bytes] = field(default_factory=lambda: Cache(at_most=MAX_PLOTS))

    def address(self, request: Request) -> str:
        """Return the address to use on the command line."""
        if self.public_url is not None:
            return self.public_url.rstrip("/")
        host, port = request.scope["server"]  # of the socket: the Host header is the client's to choose
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{port}" if port else f"http://{name}"

    async def ask(self, query: Callable[[Session], ResultT]) -> ResultT:
        """Return what functions of the service layer give in one transaction, which may change something."""
        return await _run_in_time(lambda: _run(self.services.database.transaction, query))

    async def run(self, work: Callable[[], ResultT]) -> ResultT:
        """Return what a function gives that opens its transactions itself, as the routes of the API do."""
        return await _run_in_time(work)

    async def read(self, query: Callable[[Session], ResultT]) -> ResultT:
        """Return what functions of the service layer give that only read."""
        return await _run_in_time(lambda: _run(self.services.database.reading, query))


async def _run_in_time(work: Callable[[], ResultT]) -> ResultT:
    """Run something in a thread, and leave it there when the database does not answer.

    Raises:
        ServiceError: it does not.
    """
    try:
        async with asyncio.timeout(PAGE_TIMEOUT_S):
            return await asyncio.to_thread(work)
    except TimeoutError as error:
        raise ServiceError(
            ProblemCode.DATABASE_UNAVAILABLE, "The database does not answer. Nothing is lost; reload this page later."
        ) from error


def _run(opened: Callable[[], AbstractContextManager[Session]], query: Callable[[Session], ResultT]) -> ResultT:
    with opened() as session:
        return query(session)


@dataclass(frozen=True, kw_only=True)
class Viewer:
    """The signed-in visitor as templates see it.

    Attributes:
        principal: the team, judge or organizer, for the service.
        form_token: what the forms of this session carry.
        expires_at: when the session ends.
    """

    principal: Principal
    form_token: str
    expires_at: datetime

    @property
    def name(self) -> str:
        """The team's name, or the role in the plural."""
        return self.principal.team_name or f"{self.principal.role}s"

    @property
    def own_names(self) -> frozenset[str]:
        """The names under which the own team may be on boards."""
        return frozenset({self.name, self.principal.team_pseudonym or self.name})

    @property
    def organizes_service(self) -> bool:
        """Whether all teams' submissions may be changed."""
        return self.principal.organizes_service

    @property
    def has_team(self) -> bool:
        """Whether there is a team page to show."""
        return self.principal.team_id is not None

    @property
    def organizes_any(self) -> bool:
        """Whether all teams' submissions to one competition, or to all, are shown."""
        return self.principal.organizes_any

    def may_see(self, team: str, competition: str | None = None) -> bool:
        """Return whether the submissions of a team are shown; `competition`: those to a competition."""
        reads_all = self.principal.reads_all_teams or self.principal.organizes(competition or "")
        return reads_all or team in self.own_names

    def may_change(self, team: str) -> bool:
        """Return whether the submissions of a team may be changed."""
        return self.organizes_service or self.name == team


@dataclass(frozen=True, kw_only=True)
class Tab:
    """A link to one of several pages that belong together; a further one stands under a fold."""

    title: str
    target: str
    current: bool
    further: bool = False


def get_site(request: Request) -> Site:
    """Return the site that `routes.install` stored in the application."""
    return cast("Site", request.app.state.site)


async def get_viewer(request: Request) -> Viewer | None:
    """Return the signed-in visitor, or None; a session ends with its token."""
    site = get_site(request)
    cookie = request.cookies.get(COOKIE)
    session_read = site.signer.read(cookie, now=datetime.now(UTC))
    if cookie is None or session_read is None:
        return None
    principal = await none_if_unknown(
        site.read(lambda session: tokens.principal_of_token_id(session, session_read.token_id))
    )
    if principal is None:
        return None
    request.state.account = principal.account
    return Viewer(
        principal=replace(principal, signed_in_at=session_read.began_at),
        form_token=site.signer.form_token(cookie),
        expires_at=session_read.expires_at,
    )


async def none_if_unknown(authentication: Awaitable[ResultT]) -> ResultT | None:
    """Return who was authenticated, or None if the credentials are not valid."""
    try:
        return await authentication
    except ServiceError as error:
        if error.code is ProblemCode.INVALID_CREDENTIALS:
            return None
        raise


def get_principal(viewer: Viewer | None) -> Principal:
    """Return who asks, for the service."""
    return VISITOR if viewer is None else viewer.principal


class SignInNeeded(VitacError):
    """Only who is signed in sees this; the answer leads to the sign-in page."""


async def require_viewer(request: Request) -> Viewer:
    """Return the signed-in visitor.

    Raises:
        SignInNeeded: nobody is signed in.
    """
    viewer = await get_viewer(request)
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
    if not get_site(request).signer.accepts_form_token(request.cookies.get(COOKIE), token):
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


def name_competitions(show: Page) -> Page:
    """Make a page one whose header leads to the competitions."""

    @wraps(show)
    async def shown(request: Request) -> Response:
        site = get_site(request)
        request.state.competitions = await site.competitions.get(
            lambda: site.read(lambda session: competition_list_view(session).items)
        )
        return await show(request)

    return shown


def page(
    request: Request, template: str, *, viewer: Viewer | None, section: str = "", status: int = 200, **values: Any
) -> Response:
    """Answer with a page; pages of a signed-in visitor are not cached.

    With `viewer_known=False` among the values, the header offers neither to sign in nor to sign out.
    """
    site, competitions = get_site(request), getattr(request.state, "competitions", ())
    html = render(
        template,
        request,
        viewer=viewer,
        section="/competitions" if section == COMPETITION and len(competitions) > 1 else section,
        navigation=navigation(site, viewer, competitions),
        version=site.version,
        address=site.address(request),
        registration=site.services.settings.registration.value,
        public_rankings=[one for one in _find_concerned(request, competitions, values) if one.public_rankings],
        competition_titles={one.name: one.title for one in competitions} if len(competitions) > 1 else {},
        **{"viewer_known": True, **values},
    )
    if viewer is not None:
        return HTMLResponse(html, status_code=status, headers={"Cache-Control": "no-store", "Vary": "Cookie"})
    headers = {"Cache-Control": "no-cache", "Vary": "Cookie"}
    if status != HTTPStatus.OK:
        return HTMLResponse(html, status_code=status, headers=headers)
    body = html.encode()
    return answer(request, body, revision=sha256(body).hexdigest()[:32], media_type=HTML, headers=headers)


def _find_concerned(
    request: Request, competitions: Sequence[CompetitionSummaryView], values: Mapping[str, Any]
) -> Sequence[CompetitionSummaryView]:
    """Return the competitions that a page is about: its own, that of its submission or track, or the only one."""
    address = request.path_params
    if f"{request.url.path}/".startswith(f"{COMPETITION}/"):
        return competitions[:1]
    if "competition" in address:
        return [one for one in competitions if one.name == address["competition"]]
    if "submission_id" in address:
        return [one for one in competitions if one.name == getattr(values.get("submission"), "competition", None)]
    if "track" in address:
        return [one for one in competitions if address["track"] in one.tracks][:1]
    return competitions if len(competitions) == 1 or request.url.path in {"/", "/competitions"} else ()


def navigation(
    site: Site, viewer: Viewer | None, competitions: Sequence[CompetitionSummaryView] = ()
) -> tuple[tuple[str, str], ...]:
    """Return targets and labels of the navigation; it leads to the only competition, or to the page of all."""
    first = f"/tracks/{site.tracks[0]}"
    links = [(first, "Leaderboard"), (f"{first}/rules", "Rules"), ("/docs/", "Documentation")]
    if competitions:
        links.insert(0, ("/competitions", "Competitions") if len(competitions) > 1 else (COMPETITION, "Competition"))
    if viewer is not None:
        links.append(("/submissions", "Submissions"))
        if viewer.has_team:
            links.append(("/team", "Team"))
        if viewer.principal.reads_all_teams or viewer.organizes_any:
            links.append(("/judging", "Judging"))
        if viewer.organizes_any:
            links.append(("/desk", "Desk"))
        if viewer.organizes_service:
            links.append(("/operations", "Operations"))
    return tuple(links)
