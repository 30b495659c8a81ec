"""How the generated gel mesh answers a grasp compared with the challenge's mesh; prints a table.

Usage: python benchmarks/reference/gel_mesh.py REFERENCE_DIR [--episodes N] [--json FILE]

REFERENCE_DIR holds assets/track1 and logs/track1_peg_insertion.repeat0.jsonl. No GPU, about a minute for 30 episodes.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GelMesh, signed_volumes_m3
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, Stopwatch
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv, PegInsertionSettings, PegScene, PegStart

FloatArray = np.ndarray[Any, np.dtype[np.float64]]
SHEAR_MODULUS_PA = 3e5 / (2 * 1.3)
LAME_LAMBDA_PA = 3e5 * 0.3 / (1.3 * 0.4)


def driven_force_n(mesh: GelMesh, positions_m: FloatArray) -> FloatArray:
    """Return the elastic force [N] of the gel on its driven nodes: the sum of -V P grad N over them (neo-Hookean P)."""
    rest = mesh.rest_position_m[mesh.tetrahedra]
    rest_edges = np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2)
    now = positions_m[mesh.tetrahedra]
    deformation = np.swapaxes(now[:, 1:] - now[:, :1], 1, 2) @ np.linalg.inv(rest_edges)
    inverse_transposed = np.swapaxes(np.linalg.inv(deformation), 1, 2)
    log_j = np.log(np.linalg.det(deformation))[:, None, None]
    stress = SHEAR_MODULUS_PA * (deformation - inverse_transposed) + LAME_LAMBDA_PA * log_j * inverse_transposed
    inner = np.linalg.inv(rest_edges)
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    forces = -np.einsum("t,tij,taj->tai", signed_volumes_m3(rest), stress, gradients)
    total = np.zeros_like(positions_m)
    np.add.at(total, mesh.tetrahedra, forces)
    return np.asarray(total[mesh.driven].sum(axis=0))


def grasp_response(meshes: Meshes, shape: PegShape, offset: PegOffset) -> dict[str, float]:
    """Return the force of the grasp and mean motion of the sensing surface, after grasp and after the first descent."""
    scene = PegScene(
        start=PegStart(shape=shape, offset=offset),
        meshes=meshes,
        settings=PegInsertionSettings(),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    gel = meshes.gel()
    grasped = scene.grasped
    rest_view = grasped._sensors[0].view_m(gel.rest_position_m, np.eye(3), np.zeros(3))
    scene.grasp()
    view, rotation = grasped._views_m()[0], grasped.sensor_pose(0).rotation
    force = rotation.T @ driven_force_n(gel, grasped.gel_nodes_m(0))
    moved = view - rest_view
    return {
        "normal_force_n": float(abs(force[2])),
        "shear_force_n": float(np.hypot(force[0], force[1])),
        "mean_indentation_mm": float(-moved[:, 2].mean() * 1e3),
        "mean_lateral_motion_mm": float(np.hypot(moved[:, 0], moved[:, 1]).mean() * 1e3),
        "surface_diff_mm": float(grasped.surface_diff_m()[0] * 1e3),
    }


def replayed(env: PegInsertionEnv, episodes: list[dict[str, Any]]) -> Iterator[tuple[int, float, float]]:
    """Return the env step and surface_diff [mm] of both sensors over the logged actions."""
    for episode in episodes:
        env.reset(options={"shape": episode["shape"], "offset_mm_deg": episode["initial_offset"]})
        for step in episode["steps"]:
            *_, info = env.step(np.array(step["action"], dtype=np.float32))
            left, right = info["surface_diff_m"] * 1e3
            yield step["n"], left, right


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--episodes", type=int, default=90)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    assets = arguments.reference_dir / "assets" / "track1"
    log = arguments.reference_dir / "logs" / "track1_peg_insertion.repeat0.jsonl"
    episodes = [json.loads(line) for line in log.read_text().splitlines()[: arguments.episodes]]

    sources = {"challenge": Meshes(assets), "generated": Meshes()}
    offset = PegOffset(x_mm=-4.0, y_mm=1.0, theta_deg=-6.0)
    result: dict[str, Any] = {
        name: {str(shape): grasp_response(meshes, shape, offset) for shape in PegShape}
        for name, meshes in sources.items()
    }
    runs = {
        "challenge": list(replayed(PegInsertionEnv(assets_dir=assets), episodes)),
        "generated": list(replayed(PegInsertionEnv(), episodes)),
    }
    challenge, generated = (np.array(runs[name]) for name in ("challenge", "generated"))
    for n in (1, 2, 3):
        rows = challenge[:, 0] == n
        apart = np.abs(generated[rows, 1:] - challenge[rows, 1:])
        result[f"env_step_{n}"] = {
            "values": int(apart.size),
            "mean_challenge_mm": float(challenge[rows, 1:].mean()),
            "mean_generated_mm": float(generated[rows, 1:].mean()),
            "median_deviation_mm": float(np.median(apart)),
            "p90_deviation_mm": float(np.percentile(apart, 90)),
            "max_deviation_mm": float(apart.max()),
        }
    text = json.dumps(result, indent=1)
    sys.stdout.write(text + "\n")
    if arguments.json:
        arguments.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
