"""The rules of a track."""

from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import Response
from vitac.envs.maniskill import scenes
from vitac.envs.maniskill.definition import PREFIX, is_maniskill
from vitac.evaluator.agent.protocol.action import ACTION_TYPES
from vitac.evaluator.tracks import Task

from ..limits import limit_rows, size
from ..rendering import STATIC
from ..site import get_site, get_viewer, page
from .leaderboards.tabs import accepts_logs, known_track, track_tabs


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a task: a static file, its size [px] and what it shows, for whoever does not see it.

    A drawn one is black on white, and a dark page shows it white on black; what a camera sees stays as it is.
    """

    file: str
    width: int
    height: int
    shows: str
    is_drawn: bool = False


_SCENE = (
    "The gripper's two gels, coloured by stress, hold the part over its target, which is cut open; beside it "
    "the marker flow of both sensors, which a policy observes"
)
PICTURES = {
    "peg-insertion": Picture(file="peg-insertion.png", width=1000, height=570, shows=_SCENE, is_drawn=True),
    "lock-opening": Picture(file="lock-opening.png", width=1000, height=570, shows=_SCENE, is_drawn=True),
    "fusion-insertion": Picture(
        file="fusion-insertion.png",
        width=1000,
        height=640,
        shows="Colour, depth with a scale in mm, the two infrared pictures that depth is measured with, and the point "
        "cloud, at one env step",
    ),
}
"""Drawn by `vitac show`, with `--view cameras` where there are any."""


async def rules(request: Request) -> Response:
    """Show the rules of a track, from its file and the limits in force."""
    track, site = known_track(request.path_params["track"]), get_site(request)
    settings = site.services.settings
    return page(
        request,
        "rules.html",
        viewer=await get_viewer(request),
        section=f"/tracks/{track.name}/rules",
        track=track,
        action_types=ACTION_TYPES,
        limits=limit_rows(settings.limits),
        accepts_logs=accepts_logs(track),
        log_size=size(settings.log_bytes),
        track_tabs=track_tabs(site, track, "/rules"),
        pictures={name: found for name, task in track.tasks.items() if (found := find_picture(task))},
    )


def find_picture(task: Task) -> Picture | None:
    """Return the picture of a task; None where it has none."""
    if not is_maniskill(task.env_id):
        return PICTURES.get(task.name)
    file = scenes.file_name(task.env_id.removeprefix(PREFIX))
    if not (STATIC / file).exists():
        return None
    return Picture(file=file, width=scenes.WIDTH, height=scenes.HEIGHT, shows=f"A start of {task.env_id}")
