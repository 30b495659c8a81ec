"""What an evaluation is made with: named in its manifest, so that results of different makes are never mixed."""

from typing import Protocol

from ..tracks import Task, Track
from ..tracks.registry import compute_hash, find_version, list_parts
from ..version import platform_class
from .records import Manifest


class SimulationVersions(Protocol):
    """What episodes are played with."""

    @property
    def solver_version(self) -> str:
        """Version of what moves the parts."""

    def mesh_hash(self) -> str:
        """Return the SHA-256 [hex] of the meshes and settings."""


def make_manifest(track: Track, task: Task, env: SimulationVersions) -> Manifest:
    """Return what an evaluation in this environment, or on a station, is made with."""
    return Manifest(
        track=track.name,
        task=task.name,
        list_seed=task.episode_list.list_seed,
        task_hash=task.digest(),
        evaluator_version=find_version(track.name),
        evaluator_hash=compute_hash(track.name),
        evaluator_parts=dict(list_parts(track.name)),
        solver_version=env.solver_version,
        mesh_hash=env.mesh_hash(),
        platform_class=platform_class(),
    )
