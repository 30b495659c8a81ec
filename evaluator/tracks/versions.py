"""The evaluator version of each track: of our own sources, and of what a track from elsewhere adds to them.

A track file beside this module is a part of our sources, as are its tasks. Only the results of a track from the folder
that VITAC_TRACKS_DIR names, or of a task from another package, depend on more. So whatever else is installed or lies
there, the versions and result hashes of all other tracks stay as they are.
"""

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from vitac.envs.tasks.registry import find_package

from ..version import evaluator_hash, evaluator_parts, evaluator_version, format_version, sources_hash
from .registry import further_track_files, list_tracks, load_track


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
    return frozenset({evaluator_version(), *map(find_version, list_tracks())})


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
