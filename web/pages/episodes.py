"""Pages of one episode: its map, plots and playback; what others embed of it; the page of a station's trial."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, wraps
from http import HTTPStatus
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from vitac.envs.maniskill.definition import is_maniskill
from vitac.envs.tasks.definition import Family
from vitac.evaluator.playback import NotPlayable, require_playable
from vitac.evaluator.tracks import Task, load_track
from vitac.server.api.access import get_client_address
from vitac.server.database.models import EpisodeResult
from vitac.server.database.states import OPEN_WORK_STATES, WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.reading import shown_leaderboard
from vitac.server.playbacks import asking, comparisons, work
from vitac.server.playbacks.asking import NOBODY_DRAWS, PlaybackFile
from vitac.server.principals import Principal
from vitac.server.submissions import trials
from vitac.server.views.comparisons import EpisodeChoiceView, PlaybackView, ShownEpisodeView

from ..headers import EMBEDDED
from ..plots.map import describe_start
from ..rendering import STATIC, words
from ..session import read_form
from ..site import Page, Viewer, get_principal, get_site, get_viewer, open_to_all, page, require_form_token
from .addresses import as_id

FOLDERS = ("episodes", "practice")
"""Addresses of episodes below a submission's page: of its result, and of the public list played beside a sealed one."""
TRIAL = "/submissions/{submission_id}/trials/{task}/{number}"
EMBED = "/embed"
"""Before an episode's address: its player alone, for frames of other sites."""
PLAYER = "playback.js"
ONE_YEAR_S = 365 * 24 * 3600
_PICTURES = (PlaybackFile.STILL, PlaybackFile.FILM)
_PLACES = "Expected an episode as NUMBER, or SUBMISSION:NUMBER for one of another submission, got {!r:.60}."


@dataclass(frozen=True, kw_only=True)
class EpisodeAddress:
    """An episode of a submission's newest evaluation; with `practice` on the public list beside a sealed one."""

    submission_id: UUID
    task: str
    number: int
    practice: bool = False


@dataclass(frozen=True, kw_only=True)
class EpisodePage:
    """An episode on its page.

    Attributes:
        address: of its page.
        shown: the episode.
    """

    address: str
    shown: ShownEpisodeView

    @property
    def task(self) -> Task:
        """What is played."""
        return load_track(self.shown.track).task(self.shown.task)

    @property
    def is_filmed(self) -> bool:
        """Whether its playback is a film, as of ManiSkill's environments."""
        return is_maniskill(self.task.env_id)

    @property
    def state(self) -> str:
        """State of its playback: empty as long as nobody has asked for it, `none` where there cannot be one.

        A made film is `filmed`: the page's script has nothing to do for it.
        """
        if self._refusal:
            return "none"
        if self.shown.playback is None:
            return ""
        state = self.shown.playback.state
        return "filmed" if self.is_filmed and state is WorkState.DONE else state.value

    @property
    def heading(self) -> str:
        """How the episode is called above its player."""
        if self.is_filmed:  # the start follows from a seed, and has no name
            return f"{self.shown.submission_name}, episode {self.shown.episode}"
        start = f"{words(self.shown.shape)}, {describe_start(self.task, self.shown.initial_offset)}"
        return f"{self.shown.submission_name}, episode {self.shown.episode}: {start}"

    @property
    def text(self) -> str:
        """What is said of a playback that is not there, or not yet."""
        if self._refusal or self.shown.playback is None:
            return self._refusal
        return progress(self.shown.playback)

    @property
    def _refusal(self) -> str:
        """Why there are no playbacks of the task; empty where there are."""
        try:
            require_playable(self.task)
        except NotPlayable as error:
            return str(error)
        return ""


@open_to_all
async def episode(request: Request) -> Response:
    """Show an episode, beside another one if the address names one; nothing is computed by looking."""
    viewer = await get_viewer(request)
    place = read_place(request)
    players = [await make_player(request, viewer, place)]
    beside = _read_beside(request)
    if beside:
        players.append(await make_player(request, viewer, _episode_beside(place, beside)))
    task = load_track(players[0].shown.track).task(place.task)
    choices = () if place.practice else await _choices(request, viewer, place, players[0].shown.track)
    return page(
        request,
        "episode.html",
        viewer=viewer,
        section="" if viewer is None else "/submissions",
        players=players,
        all_filmed=all(player.is_filmed for player in players),
        beside=beside,
        choices=choices,
        results=list_results(place, choices, players[1:]),
        embed=EMBED + _address(place) if await _is_public(request, viewer, place) else "",
        is_practice=place.practice,
        title=f"{task.title}, episode {place.number}",
        neighbours=_neighbours(place, task),
        episodes=len(task.episodes),
        player_script=player_script(),
        waits=any(player.shown.playback and player.shown.playback.state in OPEN_WORK_STATES for player in players),
    )


@open_to_all
async def ask(request: Request) -> Response:
    """Ask for the playback of an episode; for a public one a visitor may, too, who has no session and so no token."""
    viewer = await get_viewer(request)
    fields = await read_form(request)
    if viewer is not None:
        require_form_token(request, fields, viewer)
    place = read_place(request)
    asked = await _ask_for_playback(request, viewer, place)
    if "text/html" not in request.headers.get("accept", ""):
        return _state(asked)
    beside = fields.get("beside", "")
    shown = request.url.path.removesuffix("/playback")
    return RedirectResponse(f"{shown}?beside={beside}" if _is_place(beside) else shown, 303)


@open_to_all
async def playback(request: Request) -> Response:
    """Answer how far a playback is, as JSON, for the page's script."""
    viewer = await get_viewer(request)
    shown = await _shown_episode(request, viewer, read_place(request))
    if shown.playback is None:
        raise HTTPException(404)
    return _state(shown.playback)


@open_to_all
async def playback_file(request: Request) -> Response:
    """Answer with a file of a playback; under its key it never changes."""
    viewer = await get_viewer(request)
    try:
        file = PlaybackFile(request.path_params["file"])
    except ValueError as error:
        raise HTTPException(404) from error
    content = await _read_file(request, viewer, read_place(request), file)
    is_named = "v" in request.query_params
    headers = {
        "Cache-Control": f"private, max-age={ONE_YEAR_S}, immutable" if is_named else "no-cache",
        "Vary": "Cookie",
    }
    if file in _PICTURES:
        return Response(content, media_type="image/webp", headers=headers)
    headers["Content-Encoding"] = "gzip"  # As it is stored; the browser unpacks it.
    return Response(content, media_type="application/octet-stream", headers=headers)


def progress(playback: PlaybackView) -> str:
    """Return in a sentence where a playback is."""
    if playback.state is WorkState.FAILED:
        return f"There is no playback of this episode. {playback.problem}"
    if playback.state is WorkState.RUNNING:
        return f"Being made: env step {playback.env_steps_played} of {playback.env_steps}."
    if playback.state is WorkState.DONE:
        return ""
    if playback.workers == 0:
        return f"Waiting: {'no worker is running' if playback.family is Family.TACTILE else NOBODY_DRAWS}."
    if playback.waits_for:
        others = "Another playback is" if playback.waits_for == 1 else f"{playback.waits_for} other playbacks are"
        return f"{others} made first, usually in some seconds each."
    return "This playback is made next, as soon as a worker is free; usually within a minute."


@cache
def player_script() -> str | None:
    """Return the name of the player's script; None where the set-up could not build it."""
    return PLAYER if (STATIC / PLAYER).is_file() else None


async def make_player(request: Request, viewer: Viewer | None, place: EpisodeAddress, prefix: str = "") -> EpisodePage:
    """Return an episode as the viewer may see it; `prefix` stands before the address of its page."""
    return EpisodePage(address=prefix + _address(place), shown=await _shown_episode(request, viewer, place))


def list_results(
    place: EpisodeAddress, choices: Sequence[EpisodeChoiceView], beside: Sequence[EpisodePage]
) -> dict[str, str]:
    """Return the names of other results whose episodes can be shown beside one, by their ids; what is shown is one."""
    others = {str(one.submission_id): one.label for one in choices}
    for player in beside:
        others.setdefault(player.address.split("/")[2], f"{player.shown.team}: {player.shown.submission_name}")
    others.pop(str(place.submission_id), None)
    return others


async def _choices(
    request: Request, viewer: Viewer | None, place: EpisodeAddress, track: str
) -> tuple[EpisodeChoiceView, ...]:
    """Return what can be shown beside an episode; of others, the first of the task's leaderboard comes first."""
    by = get_principal(viewer)

    def read(session: Session) -> tuple[EpisodeChoiceView, ...]:
        entries = shown_leaderboard(session, by, track, task=place.task).view.entries
        best = entries[0].submission_id if entries else None
        return comparisons.list_choices(session, by, place.submission_id, place.task, place.number, best=best)

    return await get_site(request).ask(read)


async def _is_public(request: Request, viewer: Viewer | None, place: EpisodeAddress) -> bool:
    """Return whether everybody may see an episode that the viewer sees."""
    if viewer is None:
        return True
    return await get_site(request).read(
        lambda session: asking.is_public(
            session, place.submission_id, place.task, place.number, practice=place.practice
        )
    )


async def _shown_episode(request: Request, viewer: Viewer | None, place: EpisodeAddress) -> ShownEpisodeView:
    site, by = get_site(request), get_principal(viewer)
    return await site.ask(
        lambda session: asking.shown_episode(
            session, site.services.settings, by, place.submission_id, place.task, place.number, practice=place.practice
        )
    )


async def _ask_for_playback(request: Request, viewer: Viewer | None, place: EpisodeAddress) -> PlaybackView:
    """Have the playback of an episode made; requests without a session count for their address, too."""
    site, by, settings = get_site(request), get_principal(viewer), get_site(request).services.settings
    if viewer is None:
        address = get_client_address(request)
        await asyncio.to_thread(site.playbacks.note, address, "playbacks from one address")

    def ask_for_it(session: Session) -> PlaybackView:
        episode = _find(session, by, place)
        return asking.playback_view(session, settings, asking.ask(session, settings, by, episode))

    return await site.ask(ask_for_it)


async def _read_file(request: Request, viewer: Viewer | None, place: EpisodeAddress, file: PlaybackFile) -> bytes:
    services, by = get_site(request).services, get_principal(viewer)

    def read(session: Session) -> str:
        episode = _find(session, by, place)
        return asking.find_digest(session, episode, file)

    digest = await get_site(request).ask(read)
    return await asyncio.to_thread(work.read_file, services.database, services.blobs, digest)


def _find(session: Session, by: Principal, place: EpisodeAddress) -> EpisodeResult:
    return asking.find_episode(session, by, place.submission_id, place.task, place.number, practice=place.practice)


def _state(playback: PlaybackView) -> JSONResponse:
    return JSONResponse(
        playback.model_dump(mode="json", include={"state", "env_steps", "env_steps_played"})
        | {"text": progress(playback)},
        status_code=HTTPStatus.OK,
        headers={"Cache-Control": "no-store"},
    )


def read_place(request: Request) -> EpisodeAddress:
    """Return the episode that the address of a request names."""
    values = request.path_params
    if not _is_number(values["number"]):
        raise HTTPException(404)
    submission_id = as_id(values["submission_id"])
    practice = f"/{values['submission_id']}/{FOLDERS[1]}/" in request.url.path
    return EpisodeAddress(
        submission_id=submission_id, task=values["task"], number=int(values["number"]), practice=practice
    )


def _episode_beside(place: EpisodeAddress, text: str) -> EpisodeAddress:
    """Return the episode that is to be shown beside another one; of its task, and of its submission by default."""
    submission, _, number = text.rpartition(":")
    if not _is_place(text):
        raise HTTPException(400, _PLACES.format(text))
    submission_id = as_id(submission) if submission else place.submission_id
    return replace(place, submission_id=submission_id, number=int(number))


def _read_beside(request: Request) -> str:
    """Return the episode to show beside, as NUMBER or SUBMISSION:NUMBER; the page's form names both apart."""
    of, beside = (request.query_params.get(name, "").strip() for name in ("of", "beside"))
    return f"{of}:{beside}" if of and beside else beside


def _is_place(text: str) -> bool:
    submission, _, number = text.rpartition(":")
    try:
        return _is_number(number) and (not submission or bool(as_id(submission)))
    except ServiceError:
        return False


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 8


def _address(place: EpisodeAddress) -> str:
    return f"/submissions/{place.submission_id}/{FOLDERS[place.practice]}/{place.task}/{place.number}"


def _neighbours(place: EpisodeAddress, task: Task) -> tuple[tuple[str, str], ...]:
    """Return addresses and labels of the episodes before and after one."""
    near = ((place.number - 1, "Previous episode"), (place.number + 1, "Next episode"))
    folder = _address(place).rpartition("/")[0]
    return tuple((f"{folder}/{number}", label) for number, label in near if 1 <= number <= len(task.episodes))


CLOSED = "There is no public episode here: its result is not published, or its list is sealed, or it was removed."


async def embedded(request: Request) -> Response:
    """Show an episode that everybody may see, or a sentence where there is none."""
    try:
        player: EpisodePage | None = await make_player(request, None, read_place(request), EMBED)
    except ServiceError as error:
        if error.code not in {ProblemCode.MISSING_CREDENTIALS, ProblemCode.NOT_FOUND}:
            raise
        player = None
    except HTTPException:  # no address of an episode
        player = None
    status = HTTPStatus.NOT_FOUND if player is None else HTTPStatus.OK
    answer = page(
        request,
        "embed.html",
        viewer=None,
        status=status,
        player=player,
        player_script=player_script(),
        closed=CLOSED,
    )
    answer.headers.update(EMBEDDED)
    return answer


def without_session(show: Page) -> Page:
    """Make a page one that answers everybody as a visitor, whatever cookies come with the request."""

    @wraps(show)
    async def shown(request: Request) -> Response:
        headers = [(name, value) for name, value in request.scope["headers"] if name != b"cookie"]
        return await show(Request(dict(request.scope) | {"headers": headers}, request.receive))

    return shown


@open_to_all
async def trial(request: Request) -> Response:
    """Show a trial to whoever may see it."""
    viewer, place = await get_viewer(request), read_place(request)
    by = get_principal(viewer)
    view = await get_site(request).ask(
        lambda session: trials.find_trial(session, by, place.submission_id, place.task, place.number)
    )
    task = load_track(view.track).task(view.task)
    return page(
        request,
        "trial.html",
        viewer=viewer,
        section="" if viewer is None else "/submissions",
        trial=view,
        title=f"{task.title}, trial {view.episode}",
        start=describe_start(task, view.initial_offset),
        ending=view.outcome.sentence,
    )


@open_to_all
async def trial_video(request: Request) -> Response:
    """Answer with the video of a trial."""
    viewer, place = await get_viewer(request), read_place(request)
    by, site = get_principal(viewer), get_site(request)
    named = place.submission_id, place.task, place.number
    file = await site.ask(lambda session: trials.find_video(session, by, *named))
    content = await asyncio.to_thread(site.services.blobs.read, file.sha256)
    headers = {"Cache-Control": "private, no-cache", "Content-Disposition": f'inline; filename="{file.name}"'}
    return Response(content, media_type="video/x-motion-jpeg", headers=headers)
