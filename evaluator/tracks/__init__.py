"""Tracks, their tasks and fixed episode lists, read from YAML files."""

from .definition import Episode, ListKind, Player, Task, Track, UnknownTask
from .registry import UnknownTrack, archive_folders, find_task, list_tracks, load_track

__all__ = [
    "Episode",
    "ListKind",
    "Player",
    "Task",
    "Track",
    "UnknownTask",
    "UnknownTrack",
    "archive_folders",
    "find_task",
    "list_tracks",
    "load_track",
]
