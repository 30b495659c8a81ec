"""The page of a trial that a station has played: its video, forces, moments and help. Called by `routes`."""

import asyncio

from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import load_track
from vitac.server.submissions import trials

from ..plots.map import describe_start
from ..site import get_principal, get_site, get_viewer, open_to_all, page
from .episodes import read_place

ADDRESS = "/submissions/{submission_id}/trials/{task}/{number}"


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
async def video(request: Request) -> Response:
    """Answer with the video of a trial."""
    viewer, place = await get_viewer(request), read_place(request)
    by, site = get_principal(viewer), get_site(request)
    named = place.submission_id, place.task, place.number
    file = await site.ask(lambda session: trials.find_video(session, by, *named))
    content = await asyncio.to_thread(site.services.blobs.read, file.sha256)
    headers = {"Cache-Control": "private, no-cache", "Content-Disposition": f'inline; filename="{file.name}"'}
    return Response(content, media_type="video/x-motion-jpeg", headers=headers)
