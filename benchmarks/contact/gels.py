"""How far meshes of the gel are from their continuum.

Usage: python benchmarks/contact/gels.py [--seed N] [--fine]

A ball, an edge, a face and a plate of drawn sizes at drawn places are pressed into the gel and sheared, under arena-2:
on the mesh and material of the ranked 2025 tasks, on those of arena-2, on a finer mesh, and on a fine one that stands
for the continuum of each material. Prints for each how many times the force of its continuum it takes, and how far the
lateral motion of 49 points on the sensing face is from there (RMS, as a part of that motion). `--fine` takes a
continuum of 5,346 nodes in place of 2,625.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "physics"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from block_meshes import box_surface
from small_scenes import IDENTITY
from vitac.envs.fem.model.mesh import GelBody, GelMesh, RigidBody, SurfaceMesh
from vitac.envs.fem.model.settings import ArenaContactSettings
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.scene.grasped_scene import PhysicsSettings
from vitac.envs.tactile.gel import GelCells, arena_gel_mesh, gelsight_mini_mesh, structured_gel
from vitac.envs.tactile.markers import attach_nodes, interpolated
from vitac.envs.tasks.settings import SILICONE_POISSON_RATIO, require

FloatArray = NDArray[np.float64]

# Of part and gel at the start [m], and how the gel is moved: down, then sideways.
_START_GAP_M, _PARTS = 1.01e-4, 5


@dataclass(frozen=True, kw_only=True)
class Press:
    """A part over the sensing face: its surface, the height of its origin over its lowest point, where, and moves."""

    part: SurfaceMesh
    raised_m: float
    at_m: FloatArray
    depth_m: float
    shear_m: float


def draw_presses(rng: np.random.Generator) -> dict[str, Press]:
    """Return a ball, an edge, a face and a plate."""
    import trimesh

    radius_m, edge_m = float(rng.uniform(3e-3, 6e-3)), 3e-3
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=radius_m)
    ball = SurfaceMesh(
        vertices_m=np.array(sphere.vertices), triangles=np.array(sphere.faces, dtype=np.int64), name="ball"
    )
    angle, (x, y) = rng.uniform(0.1, 1.4), rng.uniform(6e-3, 1e-2, 2)
    bar = box_surface((edge_m, 0.04, edge_m), (0.0, -0.02, 0.0), "edge")
    half = np.sqrt(0.5)
    on_edge = np.array([[half, 0.0, -half], [0.0, 1.0, 0.0], [half, 0.0, half]])
    turned = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    parts = {
        "ball": (ball, radius_m),
        "edge": (replace(bar, vertices_m=bar.vertices_m @ (turned @ on_edge).T), 0.0),
        "face": (box_surface((x, y, 4e-3), (-x / 2, -y / 2, 0.0), "face"), 0.0),
        "plate": (box_surface((0.04, 0.04, 4e-3), (-0.02, -0.02, 0.0), "plate"), 0.0),
    }
    return {
        name: Press(
            part=part, raised_m=raised_m, at_m=rng.uniform(-2e-3, 2e-3, 2), depth_m=float(rng.uniform(3e-4, 6e-4)),
            shear_m=float(rng.uniform(1e-4, 3e-4)),
        )
        for name, (part, raised_m) in parts.items()
    }  # fmt: skip


class Answer(NamedTuple):
    """What a gel answers to a press."""

    force_n: float  # that presses on the part
    motion_m: FloatArray  # lateral, of the points on the sensing face, shape [p, 2]


def press_gel(mesh: GelMesh, press: Press, points: GelMesh, poisson_ratio: float) -> Answer:
    """Press a part into a gel and shear it; the points are the sensing nodes of another gel."""
    top_m = float(mesh.rest_position_m[:, 2].max())
    gel = GelBody(mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3), poisson_ratio=poisson_ratio)
    part = RigidBody(
        mesh=press.part, rotation=IDENTITY, fixed=True,
        translation_m=np.array([*press.at_m, top_m + _START_GAP_M + press.raised_m]),
    )  # fmt: skip
    scene = Scene(gels=[gel], bodies=[part], time_step_s=0.1, contact=ArenaContactSettings())
    target_m, moved_m = mesh.rest_position_m[mesh.driven_nodes], np.zeros(3)
    for goal_m in (np.array([0.0, 0.0, press.depth_m + 1e-4]), np.array([press.shear_m, 0.0, 0.0])):
        for _ in range(_PARTS):
            moved_m = moved_m + goal_m / _PARTS
            report = scene.step(driven_targets_m=[target_m + moved_m])
            require(report.status is not StepStatus.NOT_CONVERGED, "IPC step", report.status, "a solved one")
    motion_m = scene.gel_positions_m(0) - moved_m - mesh.rest_position_m
    corners, weights = attach_nodes(points, mesh)
    return Answer(-report.gel_forces_n[0][2], interpolated(motion_m[mesh.sensing_nodes], corners, weights)[:, :2])


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fine", action="store_true")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    cells = (
        GelCells(x=28, y=22, layers=5, bevel=2, growth=1.09, is_hexahedral=True)
        if arguments.fine
        else GelCells(x=20, y=16, layers=4, bevel=2, growth=1.1, is_hexahedral=True)
    )
    finer = GelCells(x=12, y=10, layers=2, growth=1.25, is_hexahedral=True)
    reference = structured_gel(name="fine gel", cells=cells)
    ranked, ranked_ratio = gelsight_mini_mesh(), PhysicsSettings().poisson_ratio
    gels = (
        (ranked, ranked_ratio),
        (arena_gel_mesh(), SILICONE_POISSON_RATIO),
        (structured_gel(name="finer gel", cells=finer), SILICONE_POISSON_RATIO),
    )
    for name, press in draw_presses(rng).items():
        continuum = {
            ratio: press_gel(reference, press, ranked, ratio) for ratio in (ranked_ratio, SILICONE_POISSON_RATIO)
        }
        sys.stdout.write(
            f"{name}, {1e3 * press.depth_m:.2f} mm deep; a continuum of {len(reference.rest_position_m)} nodes\n"
        )
        for mesh, ratio in gels:
            answer, own = press_gel(mesh, press, ranked, ratio), continuum[ratio]
            missed = np.sqrt(((answer.motion_m - own.motion_m) ** 2).sum() / (own.motion_m**2).sum())
            sys.stdout.write(
                f"    {mesh.name}, {len(mesh.rest_position_m)} nodes, nu {ratio}: {answer.force_n:.2f} N, "
                f"{answer.force_n / own.force_n:.2f} times, motion {100 * missed:.0f} % off\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
