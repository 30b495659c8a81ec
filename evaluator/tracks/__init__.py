"""Tracks, their tasks and fixed episode lists, read from the YAML files beside this module."""

from .definition import Accepted, Episode, Task, Track
from .registry import UnknownTask, UnknownTrack, find_task, list_tracks, load_track

__all__ = [
    "Accepted",
    "Episode",
    "Task",
    "Track",
    "UnknownTask",
    "UnknownTrack",
    "find_task",
    "list_tracks",
    "load_track",
]
