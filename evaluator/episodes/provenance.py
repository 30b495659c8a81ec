"""What an evaluation is made with: named in its manifest, so that results of different makes are never mixed."""

from ..tracks import Task, Track
from ..version import evaluator_hash, evaluator_version, platform_class
from .episode import Environment
from .records import Manifest


def make_manifest(track: Track, task: Task, env: Environment) -> Manifest:
    """Return what an evaluation in this environment is made with."""
    return Manifest(
        track=track.name,
        task=task.name,
        list_seed=task.episode_list.list_seed,
        task_hash=task.digest(),
        evaluator_version=evaluator_version(),
        evaluator_hash=evaluator_hash(),
        solver_version=env.solver_version,
        mesh_hash=env.mesh_hash(),
        platform_class=platform_class(),
    )
