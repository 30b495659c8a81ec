"""The protocol with the process that makes a playback: one order to it, one JSON line for each message from it."""

from pathlib import Path
from typing import Final

from pydantic import NonNegativeInt
from vitac.envs.errors import VitacError
from vitac.envs.tasks.definition import Family

from ..episodes.records import EpisodeRecord
from ..sensors.made import MadeSensor
from ..strict_model import StrictModel
from ..tracks import Task

FORMAT: Final = 3
"""Number of the file format; playbacks in an older one are made again."""

SCENE_FILE, CAMERAS_FILE, STILL_FILE, FILM_FILE = "scene.bin.gz", "cameras.bin.gz", "still.webp", "film.webp"


class NotPlayable(VitacError):
    """There are no playbacks of a task's episodes; the message says why."""


def require_playable(task: Task) -> None:
    """Refuse a task of which there are no playbacks, before one is asked for.

    Raises:
        NotPlayable: it is played on a station, or its states do not repeat, so what would be shown is not what was
            scored.
    """
    if task.family is Family.STATION:
        raise NotPlayable(f"There are no playbacks of {task.name}: it is played on a station, not in a simulation.")
    if not task.definition.repeats:
        raise NotPlayable(
            f"There are no playbacks of {task.env_id} with these settings: its states do not repeat, so what would be "
            "shown is not what was scored."
        )


class PlaybackOrder(StrictModel):
    """What is to be made: the files of one finished episode, in a folder.

    `list_seed` is that of a sealed list; None: the one in the track's file. `sensor` is a team's own; None: the
    challenge's.
    """

    track: str
    record: EpisodeRecord
    list_seed: int | None = None
    sensor: MadeSensor | None = None
    folder: Path


class PlaybackMessage(StrictModel):
    """One line from the process: how many env steps are played, or why there is no playback, or that it is made."""

    env_steps: NonNegativeInt | None = None
    error: str | None = None
    is_made: bool = False
