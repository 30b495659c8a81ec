"""Finds track files by name; the CLI, the server and the workers all load tracks here."""

from functools import cache
from importlib.resources import files

from vitac.envs.errors import VitacError

from ..strict_model import DocumentRejected, parse_yaml
from .definition import Task, Track


class UnknownTrack(VitacError):
    """No such track; the message lists those that exist."""


class UnknownTask(VitacError):
    """The track has no such task; the message lists those that exist."""


def list_tracks() -> tuple[str, ...]:
    """Names of all tracks, sorted."""
    return tuple(
        sorted(path.name.removesuffix(".yaml") for path in files(__package__).iterdir() if path.name.endswith(".yaml"))
    )


@cache
def load_track(name: str) -> Track:
    """Read one track.

    Raises:
        UnknownTrack: no such track.
        DocumentRejected: the file is not a valid track.
    """
    if name not in list_tracks():
        raise UnknownTrack(f"There is no track {name!r}; the tracks are {', '.join(list_tracks())}.")
    origin = f"{name}.yaml"
    track = parse_yaml(Track, files(__package__).joinpath(origin).read_text(encoding="utf-8"), origin)
    if track.name != name:
        raise DocumentRejected(f"{origin} says name {track.name!r}; name and file name must agree.")
    return track


def find_task(name: str) -> tuple[Track, Task]:
    """Return the task of that name and its track; task names are unique over all tracks.

    Raises:
        UnknownTask: no track has it.
    """
    found = {task: load_track(track) for track in list_tracks() for task in load_track(track).tasks}
    if name not in found:
        raise UnknownTask(f"There is no task {name!r}; the tasks are {', '.join(sorted(found))}.")
    return found[name], found[name].tasks[name]
