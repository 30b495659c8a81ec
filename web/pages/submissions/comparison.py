"""Any results beside each other: by shape, by difficulty, in pairs, and the episodes in which they differ."""

from collections.abc import Iterator, Sequence
from functools import partial
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.evaluator.tracks import load_track
from vitac.server.leaderboards.reading import shown_leaderboard
from vitac.server.submissions.comparison import MAX_COMPARED, compare_results
from vitac.server.submissions.listing import list_submissions
from vitac.server.views.comparisons import ComparedEndView, ComparedEpisodeView, ComparedResultView, ComparisonView

from ...site import Viewer, get_principal, get_site, get_viewer, open_to_all, page
from ..addresses import as_id
from ..files import csv_file, json_file

ADDRESS = "/compare"
OFFERED = 20
"""Maximum number of a leaderboard's entries that are offered."""
SHOWN = 20
"""Maximum number of episodes on the page; files have all."""


@open_to_all
async def compare_pages(request: Request) -> Response:
    """Show the results that `?id=` names, one or several times, beside each other."""
    viewer = await get_viewer(request)
    compared = await _read(request, viewer)
    names = list(_names(compared.results))
    return page(
        request,
        "comparison.html",
        viewer=viewer,
        section="",
        found=compared,
        names=names,
        titles=_titles(compared.results),
        different=compared.differing[:SHOWN],
        beside=partial(_beside, compared),
        versions=sorted({result.evaluator_version for result in compared.results}),
        query="&".join(f"id={result.submission_id}" for result in compared.results),
        offered=await _offered(request, viewer, compared) if len(compared.results) < MAX_COMPARED else {},
    )


async def compare_csv(request: Request) -> Response:
    """Return the episodes in which they differ as a file, with two columns for each result."""
    compared = await _read(request, await get_viewer(request))
    columns = [f"{name} {what}" for name in _names(compared.results) for what in ("outcome", "env steps")]
    rows = (
        (one.task, one.episode, one.shape, *(cell for end in one.ends for cell in _cells(end)))
        for one in compared.differing
    )
    return csv_file("comparison", ("task", "episode", "shape", *columns), rows)


async def compare_json(request: Request) -> Response:
    """Return the comparison as a file, as the API answers it."""
    return json_file("comparison", (await _read(request, await get_viewer(request))).model_dump(mode="json"))


async def compare_with(request: Request) -> Response:
    """Lead from the address below a submission, with `?with=` another one, to the page of both."""
    named = (request.path_params["submission_id"], request.query_params.get("with"))
    ids = [str(as_id(one)) for one in named if one]
    return RedirectResponse(f"{ADDRESS}?{'&'.join(f'id={one}' for one in ids)}", status_code=303)


def _beside(compared: ComparisonView, one: ComparedEpisodeView, place: int) -> str:
    """Return the query by which the page of an episode shows another result's beside it; empty where there is none."""
    other = next((n for n, end in enumerate(one.ends) if end is not None and n != place), None)
    return "" if other is None else f"?beside={compared.results[other].submission_id}:{one.episode}"


def _cells(end: ComparedEndView | None) -> tuple[object, object]:
    return (end.outcome, end.env_steps) if end else (None, None)


async def _read(request: Request, viewer: Viewer | None) -> ComparisonView:
    ids = [as_id(named) for named in request.query_params.getlist("id")][: MAX_COMPARED + 1]
    site, by = get_site(request), get_principal(viewer)
    return await site.read(lambda session: compare_results(session, site.services.settings, by, ids))


def _names(results: Sequence[ComparedResultView]) -> Iterator[str]:
    """Yield a name for each result, with its number where another one has the same."""
    plain = [f"{result.team}: {result.submission_name}" for result in results]
    for number, name in enumerate(plain, start=1):
        yield f"{name} ({number})" if plain.count(name) > 1 else name


def _titles(results: Sequence[ComparedResultView]) -> dict[str, str]:
    """Return the titles of all tasks of their tracks."""
    tracks = {result.track for result in results}
    return {name: task.title for track in tracks for name, task in load_track(track).tasks.items()}


async def _offered(request: Request, viewer: Viewer | None, compared: ComparisonView) -> dict[UUID, str]:
    """Return what can be added: the visitor's newest results of the track, and the first of its leaderboard."""
    if not compared.results:
        return {}
    track, taken = compared.results[0].track, {result.submission_id for result in compared.results}
    site, by = get_site(request), get_principal(viewer)

    def read(session: Session) -> dict[UUID, str]:
        own = list_submissions(session, site.services.settings, by, track=track).items if viewer else []
        listed = {one.id: f"{one.team.name}: {one.name}" for one in own if one.evaluation.scores}
        for entry in shown_leaderboard(session, by, track).view.entries[:OFFERED]:
            listed.setdefault(entry.submission_id, f"{entry.team}: {entry.submission_name}")
        return {submission_id: name for submission_id, name in listed.items() if submission_id not in taken}

    return await site.read(read)
