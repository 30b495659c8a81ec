"""How far meshes of the gel are from their continuum, and the gap of contact from none.

Usage: python benchmarks/contact/gels.py [--seed N] [--fine] [--gaps]

A ball, an edge, a face and a plate of drawn sizes at drawn places are pressed into the gel and sheared, under arena-2:
on the mesh and material of the ranked 2025 tasks, on those of arena-2, on a finer mesh, and on a fine one that stands
for the continuum of each material. Prints for each how many times the force of its continuum it takes, and how far the
lateral motion of 49 points on the sensing face is from there (RMS, as a part of that motion). `--fine` takes a
continuum of 5,346 nodes in place of 2,625. `--gaps` takes arena-2's gel alone, with the gap at which bodies begin to
press halved four times from 0.2 mm, against the smallest one.
"""

import argparse
import sys
from collections.abc import Iterator
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

_PARTS = 5
"""IPC steps of each move: down, then sideways."""
GAPS_M = (2e-4, 1e-4, 5e-5, 2.5e-5, 1.25e-5)


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


def press_gel(
    mesh: GelMesh, press: Press, points: GelMesh, poisson_ratio: float, contact: ArenaContactSettings
) -> Answer:
    """Press a part into a gel and shear it; the points are the sensing nodes of another gel."""
    top_m = float(mesh.rest_position_m[:, 2].max())
    gel = GelBody(mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3), poisson_ratio=poisson_ratio)
    part = RigidBody(
        mesh=press.part, rotation=IDENTITY, fixed=True,
        translation_m=np.array([*press.at_m, top_m + 1.01 * contact.d_hat_m + press.raised_m]),
    )  # fmt: skip
    scene = Scene(gels=[gel], bodies=[part], time_step_s=0.1, contact=contact)
    target_m, moved_m = mesh.rest_position_m[mesh.driven_nodes], np.zeros(3)
    for goal_m in (np.array([0.0, 0.0, press.depth_m + contact.d_hat_m]), np.array([press.shear_m, 0.0, 0.0])):
        for _ in range(_PARTS):
            moved_m = moved_m + goal_m / _PARTS
            report = scene.step(driven_targets_m=[target_m + moved_m])
            require(report.status is not StepStatus.NOT_CONVERGED, "IPC step", report.status, "a solved one")
    motion_m = scene.gel_positions_m(0) - moved_m - mesh.rest_position_m
    corners, weights = attach_nodes(points, mesh)
    return Answer(-report.gel_forces_n[0][2], interpolated(motion_m[mesh.sensing_nodes], corners, weights)[:, :2])


def miss_motion(found: Answer, true: Answer) -> float:
    """Return how far a motion is from the true one, as a part of that (RMS)."""
    return float(np.sqrt(((found.motion_m - true.motion_m) ** 2).sum() / (true.motion_m**2).sum()))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--gaps", action="store_true")
    arguments = parser.parse_args()
    for name, press in draw_presses(np.random.default_rng(arguments.seed)).items():
        lines = compare_gaps(press) if arguments.gaps else compare_meshes(press, is_fine=arguments.fine)
        sys.stdout.write(f"{name}, {1e3 * press.depth_m:.2f} mm deep\n" + "".join(f"    {line}\n" for line in lines))
        sys.stdout.flush()


def compare_meshes(press: Press, *, is_fine: bool) -> Iterator[str]:
    """Yield a line for each mesh, against a fine one of the same material."""
    cells = (
        GelCells(x=28, y=22, layers=5, bevel=2, growth=1.09, is_hexahedral=True)
        if is_fine
        else GelCells(x=20, y=16, layers=4, bevel=2, growth=1.1, is_hexahedral=True)
    )
    reference = structured_gel(name="fine gel", cells=cells)
    finer = GelCells(x=12, y=10, layers=2, growth=1.25, is_hexahedral=True)
    ranked, ranked_ratio, contact = gelsight_mini_mesh(), PhysicsSettings().poisson_ratio, ArenaContactSettings()
    continuum = {
        ratio: press_gel(reference, press, ranked, ratio, contact) for ratio in (ranked_ratio, SILICONE_POISSON_RATIO)
    }
    yield f"a continuum of {len(reference.rest_position_m)} nodes"
    for mesh, ratio in (
        (ranked, ranked_ratio),
        (arena_gel_mesh(), SILICONE_POISSON_RATIO),
        (structured_gel(name="finer gel", cells=finer), SILICONE_POISSON_RATIO),
    ):
        answer, own = press_gel(mesh, press, ranked, ratio, contact), continuum[ratio]
        yield (
            f"{mesh.name}, {len(mesh.rest_position_m)} nodes, nu {ratio}: {answer.force_n:.2f} N, "
            f"{answer.force_n / own.force_n:.2f} times, motion {100 * miss_motion(answer, own):.0f} % off"
        )


def compare_gaps(press: Press) -> Iterator[str]:
    """Yield a line for each gap, against the smallest one."""
    gel, points = arena_gel_mesh(), gelsight_mini_mesh()
    answers = [
        press_gel(gel, press, points, SILICONE_POISSON_RATIO, ArenaContactSettings(d_hat_m=gap_m)) for gap_m in GAPS_M
    ]
    for gap_m, answer in zip(GAPS_M, answers, strict=True):
        yield (
            f"gap {1e3 * gap_m:.4g} mm: {answer.force_n:.2f} N, {answer.force_n / answers[-1].force_n:.3f} times, "
            f"motion {100 * miss_motion(answer, answers[-1]):.1f} % off"
        )


if __name__ == "__main__":
    main()
