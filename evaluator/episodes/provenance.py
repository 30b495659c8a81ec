"""What an evaluation is made with: named in its manifest, so that results of different makes are never mixed."""

from ..tracks import Task, Track
from ..tracks.versions import compute_hash, find_version, list_parts
from ..version import platform_class
from .episode import Environment
from .records import Manifest


def make_manifest(track: Track, task: Task, env: Environment) -> Manifest:
    """Return what an evaluation in this environment is made with."""
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
