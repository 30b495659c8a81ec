"""A key trails its gripper where IPC steps are cut off as the 2025 simulator cuts them off; solved ones leave no trail.

Usage: python benchmarks/reference/unsettled_lock.py REFERENCE_DIR [--episodes N ...] [--json FILE]

Plays logged lock episodes twice, sensors without jitter: in our physics, and in the slow oracle of the tests, cut off
after 5 Newton iterations of 50 conjugate-gradient iterations each. Half a minute of CPU for an episode.
`benchmarks/physics.md` says what the figures mean.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.geometry.keys_and_locks import KeyShape, key_control_points
from vitac.envs.geometry.solid import nearest_vertices
from vitac.envs.scene.grasped_scene import Clocks, Stopwatch
from vitac.envs.tasks.lock_opening.env import KeyOffset, LockOpeningSettings, LockScene, LockStart, SensorJitter

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support" / "physics"))
from slow_oracle import SlowOracle

FloatArray = NDArray[np.float64]
NEWTON_ITERATIONS, CG_ITERATIONS = 5, 50


class CutOffOracle(SlowOracle):
    """Solves an IPC step as little as the 2025 simulator does, in its unknowns: nodes, t and A of the key."""

    def step(self, driven_targets_m: FloatArray) -> None:
        """Move the driven nodes [m] and do the fixed number of iterations, whatever is left then."""
        start, predicted = self.X, self.X + self._h * self._velocity
        move = np.zeros_like(start)
        move[self._driven] = driven_targets_m.ravel() - start[self._driven]
        X = start + self._allowed_part(start, move, 1.0) * move
        for _ in range(NEWTON_ITERATIONS):
            force, jacobian = self._forces(X, start, predicted)
            rows = jacobian[self._free][:, self._free]
            move = np.zeros_like(start)
            move[self._free] = conjugate_gradients(0.5 * (rows + rows.T), -force[self._free])
            X = X + self._allowed_part(X, move, 1.0) * move
        self.X, self._velocity = X, (X - start) / self._h


def conjugate_gradients(matrix: Any, right: FloatArray) -> FloatArray:
    """Run a fixed number of iterations with the inverse diagonal as preconditioner; fewer at negative curvature."""
    inverse = 1.0 / np.abs(matrix.diagonal())
    solution, residual = np.zeros_like(right), right
    direction = inverse * residual
    size = residual @ (inverse * residual)
    for _ in range(CG_ITERATIONS):
        image = matrix @ direction
        curvature = direction @ image
        if curvature <= 0.0:
            break
        solution = solution + size / curvature * direction
        residual = residual - size / curvature * image
        before, size = size, residual @ (inverse * residual)
        direction = inverse * residual + size / before * direction
    return solution


def main() -> None:
    """Play, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--episodes", type=int, nargs="+", default=[2, 5, 18])
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.reference_dir
    lines = (folder / "logs" / "track1_open_lock.repeat0.jsonl").read_text().splitlines()
    logged = {episode["episode"]: episode for episode in map(json.loads, lines)}
    meshes = Meshes(folder / "assets" / "track1")
    result = {number: trails(logged[number], meshes) for number in arguments.episodes}
    text = json.dumps(result, indent=1)
    sys.stdout.write(text + "\n")
    if arguments.json:
        arguments.json.write_text(text + "\n")


def trails(episode: dict[str, Any], meshes: Meshes) -> list[dict[str, float]]:
    """Return the lift of the gripper after each env step, and of the lowest tooth corner in both solutions [mm]."""
    shape, settings = KeyShape(episode["shape"]), LockOpeningSettings()
    x_mm, y_mm, z_mm = episode["initial_offset"]
    start = LockStart(
        shape=shape,
        offset=KeyOffset(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm),
        jitter=SensorJitter(x_mm=0.0, z_mm=0.0),
    )
    clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
    scene = LockScene(start=start, meshes=meshes, settings=settings, clocks=clocks)
    grasped, oracle = scene.grasped, CutOffOracle(scene.grasped)
    points = key_control_points(shape)
    corners = nearest_vertices(grasped.held_surface, np.concatenate([points.rear_tooth_m, points.front_tooth_m]))
    driven = grasped.gel.driven_nodes
    grasped.after_ipc_step = lambda: oracle.step(
        np.concatenate([grasped.gel_nodes_m(index)[driven] for index in range(2)])
    )
    scene.grasp()
    lifts = []
    scale_mm = np.array(settings.action_scale_mm)
    for step in episode["steps"]:
        inwards_mm, down_mm = (np.array(step["action"]) * scale_mm).tolist()
        scene.travel(-inwards_mm, -down_mm)
        heights_m = (grasped.held_vertices_m(corners)[:, 2].min(), oracle.held_vertices_m()[corners, 2].min())
        settled_mm, cut_off_mm = (1e3 * (height - points.rear_tooth_m[0, 2]) for height in heights_m)
        gripper_mm = scene.relative_motion_mm()[2]
        lifts.append({"gripper_mm": gripper_mm, "settled_mm": settled_mm, "cut_off_mm": cut_off_mm})
    return [{name: round(float(value), 3) for name, value in lift.items()} for lift in lifts]


if __name__ == "__main__":
    main()
