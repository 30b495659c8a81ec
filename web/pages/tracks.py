"""The rules of a track."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import Response
from vitac.envs.maniskill import batch
from vitac.envs.maniskill.definition import PREFIX, is_maniskill
from vitac.evaluator.agent.protocol import ACTION_TYPES
from vitac.evaluator.tracks import Task, find_task

from ..headers import limit_rows, size
from ..rendering import STATIC
from ..site import get_site, get_viewer, page
from .leaderboards import accepts_logs, known_track, track_tabs


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a task: a static file, its size [px] and what it shows, for whoever does not see it."""

    file: str
    width: int
    height: int
    shows: str


def _scene(task: str, shows: str) -> Picture:
    return Picture(file=f"{task}.webp", width=896, height=560, shows=shows)


def _sensor(task: str, side: str) -> Picture:
    shows = f"What the {side} sensor sees of its gel: an arrow at each marker shows how it has moved since the grasp"
    return Picture(file=f"{task}-{side}.webp", width=480, height=360, shows=shows)


def _camera(what: str, shows: str) -> Picture:
    return Picture(file=f"fusion-insertion-{what}.webp", width=537, height=453, shows=shows)


_PEG = "A gripper whose two gels hold a peg in its hole, in a plate that is cut open"
PICTURES: Mapping[str, Sequence[Picture]] = {
    "peg-insertion": (
        _scene("peg-insertion", _PEG),
        _sensor("peg-insertion", "left"),
        _sensor("peg-insertion", "right"),
    ),
    "lock-opening": (
        _scene("lock-opening", "A gripper whose two gels hold a key with its teeth in the slots of a lock, cut open"),
        _sensor("lock-opening", "left"),
        _sensor("lock-opening", "right"),
    ),
    "fusion-insertion": (
        _scene("fusion-insertion", "A gripper whose two gels hold a peg in one of two holes of a base, cut open"),
        _sensor("fusion-insertion", "left"),
        _camera("colour", "What the camera sees: the base blue, the peg red"),
        _camera("depth", "Depth as the camera measures it, with gaps where it finds none"),
    ),
    "sensor-standard": (
        _scene("sensor-standard", _PEG),
        _sensor("sensor-standard", "left"),
        _sensor("sensor-standard", "right"),
    ),
    "peg-insertion-2024": (_scene("peg-insertion-2024", _PEG),),
    "in-hand-turn": (
        _scene(
            "in-hand-turn", "A gripper whose two gels hold a rod by its flat head, pressed against the edge of a bar"
        ),
    ),
    "soft-plug": (_scene("soft-plug", "A gripper whose two gels hold a soft plug, bent above a plate with a hole"),),
    "cable-end": (
        _scene("cable-end", "A gripper whose two gels hold a cable by its boot, bent above a plate with a hole"),
    ),
    "assembly": (
        _scene(
            "assembly", "A gripper whose two gels hold a part by its head, its two lugs in a socket that is cut open"
        ),
    ),
    "slip": (_scene("slip", "A gripper whose two gels hold a hexagonal column above a table"),),
    "explore": (_scene("explore", "A gripper whose two gels hold a block; below it a cross, one arm of it on a pin"),),
    "moving-hole": (_scene("moving-hole", f"{_PEG} that moves"),),
    "lock-opening-2024": (
        _scene(
            "lock-opening-2024", "A gripper whose two gels hold a key, which they have pushed into a lock, cut open"
        ),
    ),
}
"""Stills as `envs/playback_files/still.py` draws them, and panels of the player, saved from its page.

Each shows the end of an episode, and what its sensors saw at a step before.
"""


NO_SCENE = "markers.svg"


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
        pictures={name: pictures for name, task in track.tasks.items() if (pictures := find_pictures(task))},
    )


def find_pictures(task: Task) -> Sequence[Picture]:
    """Return the pictures of a task, or of one of the challenge with the same environment.

    They show its scene, and what a policy sees of it.
    """
    if not is_maniskill(task.env_id):
        same = (name for name in PICTURES if find_task(name)[1].env_id == task.env_id)
        return PICTURES.get(task.name) or PICTURES.get(next(same, ""), ())
    file = batch.file_name(task.env_id.removeprefix(PREFIX))
    if not (STATIC / file).exists():
        return ()
    return (Picture(file=file, width=batch.WIDTH, height=batch.HEIGHT, shows=f"A start of {task.env_id}"),)


def find_scene(task: Task | None) -> str:
    """Return the static file with the scene of a task; a drawing of markers where there is none."""
    return next((picture.file for picture in find_pictures(task)), NO_SCENE) if task else NO_SCENE
