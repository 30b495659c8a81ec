"""Finds track files by name, and the evaluator version of each track.

The files lie beside this module, and in the folder that VITAC_TRACKS_DIR names; server and workers must be given the
same. A track beside this module has the version of our own sources; to that of another one its file adds, and the
package of its task. So whatever else is installed, the versions and result hashes of all other tracks stay as they are.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from pathlib import Path

from vitac.envs.tasks.registry import find_package
from vitac.errors import VitacError

from ..strict_model import DocumentRejected, read_yaml
from ..version import evaluator_hash, evaluator_parts, evaluator_version, format_version, sources_hash
from .definition import Task, Track, UnknownTask

TRACKS_FOLDER_VARIABLE = "VITAC_TRACKS_DIR"
"""Names a folder with further track files."""


class UnknownTrack(VitacError):
    """No such track; the message lists those that exist."""


def list_tracks() -> tuple[str, ...]:
    """Return the names of all tracks, sorted; those with an environment of ManiSkill after the others."""
    return tuple(track.name for track in _tracks(os.environ.get(TRACKS_FOLDER_VARIABLE)))


def load_track(name: str) -> Track:
    """Read one track.

    Raises:
        UnknownTrack: no such track.
        DocumentRejected: the file is not a valid track.
    """
    files = _find_track_files(os.environ.get(TRACKS_FOLDER_VARIABLE))
    if name not in files:
        raise UnknownTrack(
            f"There is no track {name!r}; the tracks are {', '.join(list_tracks())}. Others are read from the folder "
            f"that {TRACKS_FOLDER_VARIABLE} names."
        )
    return _read(files[name])


def find_task(name: str) -> tuple[Track, Task]:
    """Return the task of that name and its track; task names are unique over all tracks.

    Raises:
        UnknownTask: no track has it.
        DocumentRejected: two tracks have it.
    """
    tracks = _tracks_by_task(os.environ.get(TRACKS_FOLDER_VARIABLE))
    if name not in tracks:
        tasks = sorted(tracks)
        meant = get_close_matches(name, tasks, n=1) or [task for task in tasks if name and name in task]
        did_you_mean = f"did you mean {' or '.join(meant)}? The" if meant else "the"
        raise UnknownTask(f"There is no task {name!r}; {did_you_mean} tasks are {', '.join(tasks)}.")
    return tracks[name], tracks[name].tasks[name]


def archive_folders() -> tuple[str, ...]:
    """Return the folders that the archive of a submission may hold: each track's, once."""
    return tuple(dict.fromkeys(load_track(name).folder for name in list_tracks()))


def further_track_files() -> Mapping[str, Path]:
    """Return the track files of the folder that VITAC_TRACKS_DIR names, by track; none where it names no folder."""
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    return _further_files(folder) if folder else {}


@cache
def _tracks(further: str | None) -> tuple[Track, ...]:
    read = map(_read, _find_track_files(further).values())
    return tuple(sorted(read, key=lambda track: (track.has_maniskill, track.name)))


@cache
def _tracks_by_task(further: str | None) -> Mapping[str, Track]:
    by_task: dict[str, Track] = {}
    for track in _tracks(further):
        for task in track.tasks:
            if task in by_task:
                raise DocumentRejected(f"The tracks {by_task[task].name} and {track.name} both have a task {task!r}.")
            by_task[task] = track
    return by_task


@cache
def _find_track_files(further: str | None) -> Mapping[str, Path]:
    """Return the files by track; looked for once in a process, as the evaluator's version is."""
    own = _list_files(Path(__file__).parent)
    if not further:
        return own
    added = _further_files(further)
    if not added:
        raise DocumentRejected(f"{TRACKS_FOLDER_VARIABLE} is {further}, expected a folder with track files (*.yaml).")
    for name in added.keys() & own.keys():
        raise DocumentRejected(f"{added[name]} has the name of a track that is there already; choose another name.")
    return {**own, **added}


@cache
def _further_files(folder: str) -> dict[str, Path]:
    return _list_files(Path(folder))


def _list_files(folder: Path) -> dict[str, Path]:
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


@cache
def _read(path: Path) -> Track:
    track = read_yaml(Track, path)
    if track.name != path.stem:
        raise DocumentRejected(f"{path.name} says name {track.name!r}; name and file name must agree.")
    return track


def find_version(track: str) -> str:
    """Return what results of a track are made with; a track that is gone has the version of our own sources."""
    return format_version(compute_hash(track))


def compute_hash(track: str) -> str:
    """Return the SHA-256 [hex] of all that moves a score of a track."""
    return _hash_with_added(track) if _added_parts(track) else evaluator_hash()


def list_parts(track: str) -> Mapping[str, str]:
    """Return what the hash of a track is made of, by name, each as its version or SHA-256."""
    return {**evaluator_parts(), **_added_parts(track)}


def current_versions() -> frozenset[str]:
    """Return the versions of all tracks."""
    return frozenset({evaluator_version(), *map(find_version, further_track_files())})


def find_evaluator(version: str) -> str:
    """Return the evaluator that has a version of a track: this one for all of its own; an older version as it is."""
    return evaluator_version() if version in current_versions() else version


def differing_parts(expected: Mapping[str, str], got: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the parts that two evaluators do not have in common."""
    return tuple(sorted(name for name in {*expected, *got} if expected.get(name) != got.get(name)))


def _hash_with_added(track: str) -> str:
    content = {"evaluator": evaluator_hash(), **_added_parts(track)}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _added_parts(track: str) -> Mapping[str, str]:
    file = further_track_files().get(track)
    return _parts_of_file(track, file) if file else {}


@cache
def _parts_of_file(track: str, file: Path) -> Mapping[str, str]:
    packages = {find_package(task.env_id) for task in load_track(track).tasks.values()}
    parts = {package: sources_hash(package) for package in packages if package}
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest(), **parts}
