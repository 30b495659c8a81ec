"""Tracks by their names, and as the API and the pages show them, with the limits that submissions have to keep."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from vitac.envs.tasks.definition import Family
from vitac.evaluator.tracks import Player, Task, Track, UnknownTask, UnknownTrack, list_tracks, load_track, registry
from vitac.evaluator.tracks.registry import further_track_files

from .errors import ProblemCode, ServiceError
from .settings import Settings
from .views.tracks import TrackListView, TrackTaskView, TrackView


def load_known_track(name: str) -> Track:
    """Return the track of that name.

    Raises:
        ServiceError: there is none; the message lists those that exist.
    """
    try:
        return load_track(name)
    except UnknownTrack as error:
        tracks = list(list_tracks())
        sentence = f"There is no track {name!r}; the tracks are {', '.join(tracks)}."
        raise ServiceError(ProblemCode.UNKNOWN_TRACK, sentence, tracks=tracks) from error


def is_challenge_track(track: Track) -> bool:
    """Return whether a track is one of the challenge's own, such as `track_1` in `Track_1`, and no variant of one."""
    return track.folder.startswith("Track_") and track.name == track.folder.lower()


def sort_challenge_first(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of tracks with those of the challenge before the others."""
    return tuple(sorted(names, key=lambda name: not is_challenge_track(load_track(name))))


def is_reference(task: Task) -> bool:
    """Return whether results of a task rank nobody and are only what others are compared with: those of blind runs."""
    return task.player is Player.BLIND


def track_file(name: str) -> bytes:
    """Return the content of a track's file.

    Raises:
        ServiceError: there is no such track.
    """
    known = load_known_track(name).name
    return further_track_files().get(known, Path(registry.__file__).with_name(f"{known}.yaml")).read_bytes()


def require_task(track: Track, task: str) -> Task:
    """Return a task of a track, and refuse one that it does not have.

    Raises:
        ServiceError: with the tasks that it has.
    """
    try:
        return track.task(task)
    except UnknownTask as error:
        raise ServiceError(ProblemCode.UNKNOWN_TASK, str(error), tasks=list(track.tasks)) from error


def find_family(track: str, task: str) -> Family:
    """Return what a task needs to run; the tactile family where its track file is gone, whose workers then say so."""
    known = known_task(track, task)
    return known.family if known else Family.TACTILE


def find_playback_family(track: str, task: str) -> Family:
    """Return what the playback of an episode needs: ManiSkill's are drawn, whatever their policies observe."""
    return Family.TACTILE if find_family(track, task) is Family.TACTILE else Family.MANISKILL_PICTURES


def known_track(name: str) -> Track | None:
    """Return a track by the name that a submission has stored; None where its track file is gone."""
    try:
        return load_track(name)
    except UnknownTrack:
        return None


def known_task(track: str, task: str) -> Task | None:
    """Return a task by the name stored with a submission; None where its track file is gone or no longer has it."""
    definition = known_track(track)
    return definition.tasks.get(task) if definition is not None else None


def track_views(settings: Settings) -> TrackListView:
    """Return all tracks."""
    return TrackListView(items=[track_view(load_track(name), settings) for name in list_tracks()])


def track_view(track: Track, settings: Settings) -> TrackView:
    """Return one track."""
    return TrackView.from_row(
        track,
        accepts=list(track.accepts),
        tasks=[
            TrackTaskView.from_row(task, name=name, episodes=len(task.episodes)) for name, task in track.tasks.items()
        ],
        log_bytes=settings.log_bytes,
        limits=asdict(settings.limits),
    )
