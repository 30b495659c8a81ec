"""The page with what a submission's policy printed, episode by episode."""

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import load_track
from vitac.server.submissions import listing
from vitac.server.submissions.files import episode_outputs

from ...site import Tab, get_site, page, require_viewer
from ..addresses import as_id


async def output(request: Request) -> Response:
    """Show the output of a task's episodes, a page of them."""
    viewer = await require_viewer(request)
    submission_id = as_id(request.path_params["submission_id"])
    task, after = request.query_params.get("task"), _number(request.query_params.get("after", "0"))
    settings = get_site(request).services.settings
    view, shown = await get_site(request).ask(
        lambda session: (
            listing.get(session, settings, viewer.principal, submission_id),
            episode_outputs(session, viewer.principal, submission_id, task, after=after),
        )
    )
    track, address = load_track(view.track), f"/submissions/{submission_id}/output"
    return page(
        request,
        "output.html",
        viewer=viewer,
        section="/submissions",
        submission=view,
        shown=shown,
        tabs=[
            Tab(title=track.task(name).title, target=f"{address}?task={name}", current=name == (task or view.tasks[0]))
            for name in view.tasks
        ],
        older=f"{address}?task={task or view.tasks[0]}&after={shown.next_after}",
    )


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise HTTPException(400, f"Expected the number of an episode, got {text!r:.40}.")
    return int(text)
