"""Holds a rubber block between two gels and presses it on a soft pad that goes to and fro.

From the root of the repository: `python examples/soft_parts/press.py`. docs/environments.md explains it.
"""

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import PART_MATERIAL, GelBody, GelMesh
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, Stopwatch, fixed_at_origin
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from vitac.envs.tactile.gel import GelCells, GelDimensions, highest_mm, structured_gel
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tasks.settings import arena_physics


def box(length_mm: float, width_mm: float, height_mm: float, cells: tuple[int, int, int]) -> GelMesh:
    """Make a box of hexahedra about the z axis, its upper face at 2 mm; the lower one is driven."""
    size = GelDimensions(
        length_mm=length_mm, width_mm=width_mm, thickness_mm=height_mm, bevel_height_mm=0.0, bevel_inset_mm=0.0
    )
    x, y, layers = cells
    return structured_gel(name="box", size=size, cells=GelCells(x=x, y=y, bevel=0, layers=layers, is_hexahedral=True))


def to_and_fro(time_s: float) -> NDArray[np.float64]:
    """Return how far the pad's lower face is from its place [m], shape (3,)."""
    return np.array([1e-3 * np.sin(2.0 * np.pi * time_s / 0.8), 0.0, 0.0])


meshes = Meshes(is_arena=True)
opening_m = 6e-3 + 1e-3 * highest_mm(meshes.gel()) + 1e-4
pose = GripperPose(x_m=0.0, y_m=0.0, z_m=0.03, angle_rad=0.0, half_opening_m=opening_m)
scene = GraspedScene(
    gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=pose),
    held=GelBody(
        mesh=box(12.0, 12.0, 40.0, (3, 3, 8)).released(),
        rotation=np.eye(3),
        translation_m=np.array([0.0, 0.0, 0.043]),
        youngs_modulus_pa=2e6,
        poisson_ratio=0.45,
        material=PART_MATERIAL,
    ),
    fixed=fixed_at_origin(solid_from_faces(prism_faces(rectangle(-30, 30, -30, 30), -5, 0), "table"), friction=0.5),
    others=[
        GelBody(
            mesh=box(20.0, 20.0, 4.0, (4, 4, 2)),
            rotation=np.eye(3),
            translation_m=np.array([0.0, 0.0, 2.1e-3]),
            motion=to_and_fro,
        )
    ],
    physics=arena_physics(),
    sensors=meshes.sensors(MarkerSettings()),
    clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
)
scene.move_to(scene.pose.moved(closing_m=4e-4), ipc_steps=2)
scene.capture_references()
scene.move_to(scene.pose.moved(z_m=-1.5e-3), ipc_steps=5)
print(scene.solved, scene.grip_force_n(), scene.force_on_held_n(4), scene.held_vertices_m(np.arange(4)))
