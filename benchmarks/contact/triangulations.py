"""Does it matter how the flat faces of peg and plate are cut into triangles?

Usage: python benchmarks/contact/triangulations.py [--seed N] [--episodes 45] [--contact-model NAME]

Plays random actions from public starts of peg insertion on the generated parts, and on the same parts with their
coplanar diagonals flipped at random; starts, actions and diagonals are drawn from the seed. Prints how far surface
differences and the force on the peg, where it is above 1 N, are apart at the ends of env steps, and how many episodes
end otherwise.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - the import registers the ids
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.tracks import Episode, find_task

FloatArray = NDArray[np.float64]


def flip_diagonals(mesh: SurfaceMesh, rng: np.random.Generator) -> tuple[SurfaceMesh, int]:
    """Return the same surface after random flips of its coplanar diagonals, and how many of its edges are new."""
    triangles = [tuple(int(node) for node in triangle) for triangle in mesh.triangles]
    pairs = list(combinations(range(len(triangles)), 2))
    for one, other in rng.permutation(pairs * 3).tolist():
        shared = set(triangles[one]) & set(triangles[other])
        if len(shared) != 2 or rng.random() < 0.5:
            continue
        (apex,), (far,) = (set(triangles[index]) - shared for index in (one, other))
        start, end = (triangles[one][(triangles[one].index(apex) + turn) % 3] for turn in (1, 2))
        changed = ((apex, start, far), (apex, far, end))
        normals = [_normal(mesh, triangle) for triangle in (triangles[one], triangles[other], *changed)]
        if all(normals[0] @ normal > 1.0 - 1e-9 for normal in normals):
            triangles[one], triangles[other] = changed
    flipped = replace(mesh, triangles=np.array(triangles, dtype=np.int64))
    return flipped, len(_edges(flipped) - _edges(mesh))


def _edges(mesh: SurfaceMesh) -> set[frozenset[int]]:
    return {frozenset(pair) for triangle in mesh.triangles.tolist() for pair in combinations(triangle, 2)}


def _normal(mesh: SurfaceMesh, triangle: tuple[int, ...]) -> FloatArray:
    a, b, c = mesh.vertices_m[list(triangle)]
    normal = np.cross(b - a, c - a)
    return np.asarray(normal / max(np.linalg.norm(normal), 1e-18))


@dataclass(frozen=True, kw_only=True)
class Played:
    """An episode: why it ended, and after each env step both surface differences [m] and the force on the peg [N]."""

    end_reason: str
    surface_diff_m: FloatArray  # shape [env steps, 2]
    force_n: FloatArray  # shape [env steps, 3]


def play(env: Any, episode: Episode, actions: NDArray[np.float32]) -> Played:
    """Play actions to the end of the episode."""
    _, info = env.reset(options=episode.options)
    surfaces, forces = [], []
    for action in actions:
        observation, *_, info = env.step(action)
        surfaces.append(info["surface_diff_m"])
        forces.append(observation["contact_forces"][0])
        if info["end_reason"]:
            break
    return Played(end_reason=info["end_reason"], surface_diff_m=np.array(surfaces), force_n=np.array(forces))


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=45)
    parser.add_argument("--contact-model", choices=list(ContactModel), default=ContactModel.ARENA_2)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    _, task = find_task("peg-insertion")
    counts: list[int] = []
    generated = Meshes.part

    def flipped(meshes: Meshes, generate: Callable[[], SurfaceMesh], file: str) -> SurfaceMesh:
        mesh, count = flip_diagonals(generated(meshes, generate, file), rng)
        counts.append(count)
        return mesh

    env, other_env = (
        gymnasium.make(
            task.env_id, privileged=True, contact_model=arguments.contact_model, observation_keys=("contact_forces",)
        )
        for _ in range(2)
    )
    worst, ends = np.zeros(2), 0
    for number in range(arguments.episodes):
        episode = task.episodes[rng.integers(len(task.episodes))]
        actions = rng.uniform(-1.0, 1.0, (task.max_steps, 3)).astype(np.float32)
        played = play(env, episode, actions)
        with patch.object(Meshes, "part", flipped):
            other = play(other_env, episode, actions)
        ends += played.end_reason != other.end_reason or len(played.force_n) != len(other.force_n)
        steps = min(len(played.force_n), len(other.force_n))
        surface, force = (
            np.abs(a[:steps] - b[:steps]).max(axis=1) / np.maximum(np.linalg.norm(a[:steps], axis=1), least)
            for a, b, least in (
                (played.surface_diff_m, other.surface_diff_m, 0.0),
                (played.force_n, other.force_n, 1.0),
            )
        )
        worst = np.maximum(worst, [surface.max(), force.max()])
        print(
            f"{number + 1}: {episode.shape} {episode.offset}, {played.end_reason} and {other.end_reason} after "
            f"{steps} env steps, surface difference {surface.max():.1e}, force {force.max():.1e} apart"
        )
    print(
        f"{arguments.contact_model}, {min(counts)} to {max(counts)} diagonals of a part flipped: surface difference at "
        f"most {100 * worst[0]:.2g} %, force {100 * worst[1]:.2g} % apart; {ends} of {arguments.episodes} end otherwise"
    )


if __name__ == "__main__":
    main()
