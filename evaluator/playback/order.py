"""The protocol with the process that makes a playback: one order to it, one JSON line for each message from it."""

from pathlib import Path
from typing import Final

from pydantic import NonNegativeInt
from vitac.envs.errors import VitacError
from vitac.envs.maniskill.definition import is_maniskill

from ..episodes.records import EpisodeRecord
from ..sensors.made import MadeSensor
from ..strict_model import StrictModel

FORMAT: Final = 1
"""Number of the file format; playbacks in an older one are made again."""

SCENE_FILE, CAMERAS_FILE, STILL_FILE = "scene.bin.gz", "cameras.bin.gz", "still.png"


class NotPlayable(VitacError):
    """The environment of a task has no gels and parts as a playback shows them.

    Args:
        env_id: of the task.
    """

    def __init__(self, env_id: str) -> None:
        super().__init__(f"Episodes of {env_id} are not shown in 3D: a playback shows two gels and what they hold.")


def require_playable(env_id: str) -> None:
    """Refuse an environment that has no playbacks, before it is made.

    Raises:
        NotPlayable: it is one of ManiSkill's.
    """
    if is_maniskill(env_id):
        raise NotPlayable(env_id)


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
