"""A held part, rigid or soft, pushes a loose or a soft one onto a fixed one, and feels it."""

from dataclasses import dataclass

import numpy as np
import pytest
from block_meshes import hexahedral_box
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import PART_MATERIAL, GelBody, RigidBody
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, Stopwatch, fixed_at_origin
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from vitac.envs.scene.measured_pose import held_pose_mm_deg
from vitac.envs.tactile.gel import highest_mm
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tasks.settings import arena_physics

LOOSE_BODY = 4
LOOSE_AT_MM, HELD_AT_MM = 0.5, 6.0


def box(width_mm: float, low_mm: float, high_mm: float, name: str) -> RigidBody:
    half = 0.5 * width_mm
    mesh = solid_from_faces(prism_faces(rectangle(-half, half, -half, half), low_mm, high_mm), name)
    return RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.zeros(3))


def gripped(
    *others: RigidBody | GelBody, held: RigidBody | GelBody | None = None, physics: PhysicsSettings | None = None
) -> GraspedScene:
    meshes = Meshes()
    pose = GripperPose(
        x_m=0.0, y_m=0.0, z_m=31e-3, angle_rad=0.0, half_opening_m=(15.0 + highest_mm(meshes.gel()) + 0.1) * 1e-3
    )
    scene = GraspedScene(
        gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=pose),
        held=held or box(30.0, HELD_AT_MM, 46.0, "finger"),
        fixed=fixed_at_origin(box(60.0, -5.0, 0.0, "table").mesh, friction=0.5),
        others=others,
        physics=physics or PhysicsSettings(),
        sensors=meshes.sensors(MarkerSettings()),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    scene.move_to(scene.pose.moved(closing_m=0.975e-3), ipc_steps=2)
    scene.capture_references()
    return scene


def test_a_loose_part_is_pushed_onto_the_table_and_then_pushes_back() -> None:
    scene = gripped(box(10.0, LOOSE_AT_MM, 5.0, "loose block"))
    before, start = scene.other_vertices_m(0), scene.state()
    assert before[:, 2].min() == pytest.approx(LOOSE_AT_MM * 1e-3)
    scene.move_to(scene.pose.moved(z_m=-1.8e-3), ipc_steps=8)
    assert scene.solved
    after = scene.other_vertices_m(0)
    assert 0.0 < after[:, 2].min() < 0.1e-3
    assert scene.force_on_held_n(LOOSE_BODY) == pytest.approx(scene.contact_forces_n()[0], abs=1e-3)
    assert scene.force_on_held_n(LOOSE_BODY)[2] > 1.0
    assert (scene.force_on_held_n(3) == 0.0).all(), "the finger does not touch the table"
    scene.restore(start)
    assert (scene.other_vertices_m(0) == before).all()


def test_forces_are_right_with_a_gel_between_the_held_part_and_the_table() -> None:
    soft = GelBody(
        mesh=Meshes().gel(),
        rotation=np.eye(3),
        translation_m=np.array([0.0, 0.0, 3.5e-3]),
        youngs_modulus_pa=3e5,
        poisson_ratio=0.3,
        density_kg_m3=1000.0,
        friction=0.5,
    )
    scene = gripped(soft, box(10.0, 60.0, 61.0, "far away"))
    before = scene.other_vertices_m(0)
    scene.take_reports()
    scene.move_to(scene.pose.moved(z_m=-1.0e-3), ipc_steps=4)
    assert scene.solved
    after = scene.other_vertices_m(0)
    assert (after[soft.mesh.driven_nodes] == before[soft.mesh.driven_nodes]).all()
    assert np.abs(after - before).max() > 1e-4
    assert scene.other_vertices_m(1)[:, 2].min() == pytest.approx(60e-3)
    push_n = scene.force_on_held_n(LOOSE_BODY)
    assert push_n[2] > 0.5
    assert scene.contact_forces_n().shape == (3, 3)
    assert scene.contact_forces_n()[0] == pytest.approx(push_n, abs=1e-3)
    assert scene.peak_part_force_n() == pytest.approx(np.linalg.norm(push_n), rel=1e-3)
    assert (scene.force_on_held_n(5) == 0.0).all()
    lowest_mm = 1e3 * scene.held_vertices_m(np.arange(8))[:, 2].min()
    assert held_pose_mm_deg(scene)[2] == pytest.approx(lowest_mm - HELD_AT_MM, abs=0.05), "of the held part alone"


@dataclass(frozen=True)
class Sine:
    """To and fro along x by 1 mm, in 0.8 s."""

    def __call__(self, time_s: float) -> np.ndarray:
        return np.array([1e-3 * np.sin(2.0 * np.pi * time_s / 0.8), 0.0, 0.0])


def test_a_soft_part_is_held_between_the_gels_and_pressed_on_a_soft_pad_that_moves() -> None:
    pad_mesh = hexahedral_box((0.016, 0.016, 0.004), (4, 4, 2))
    pad = GelBody(mesh=pad_mesh, rotation=np.eye(3), translation_m=np.array([-8e-3, -8e-3, 1e-3]), motion=Sine())
    block = hexahedral_box((0.012, 0.030, 0.034), (3, 6, 7))
    held = GelBody(
        mesh=block.released(),
        rotation=np.eye(3),
        translation_m=1e-3 * np.array([-6.2, -15.0, HELD_AT_MM]),
        youngs_modulus_pa=2e6,
        poisson_ratio=0.45,
        material=PART_MATERIAL,
    )
    scene = gripped(pad, held=held, physics=arena_physics())
    assert scene.grip_force_n() > 5.0
    assert scene.contact_forces_n()[0] == pytest.approx(np.zeros(3), abs=2e-3), "nothing else touches it"
    held_m, rest_m = scene.held_vertices_m(np.arange(len(scene.held_surface.vertices_m))), scene.held_surface.vertices_m
    assert len(held_m) < len(block.rest_position_m)
    between = np.isclose(rest_m[:, 2], 5.0 / 7.0 * 34e-3)
    assert np.ptp(held_m[between, 1]) < 29.95e-3, "it is squeezed"
    state = scene.state()
    for _ in range(2):
        scene.move_to(scene.pose.moved(z_m=-1.2e-3), ipc_steps=4)
        assert scene.solved
        assert scene.contact_forces_n().shape == (3, 3)
        assert scene.force_on_held_n(LOOSE_BODY) == pytest.approx(scene.contact_forces_n()[0], abs=0.01)
        moved_m = scene.other_vertices_m(0)[pad_mesh.driven_nodes] - pad.translation_m
        assert moved_m - pad_mesh.rest_position_m[pad_mesh.driven_nodes] == pytest.approx(
            np.tile(Sine()(scene.time_s), (len(moved_m), 1)), abs=1e-12
        )
    assert scene.force_on_held_n(LOOSE_BODY)[2] > 1.0
    assert abs(scene.force_on_held_n(LOOSE_BODY)[0]) > 0.05, "the pad drags at it"
    ended = scene.state_hash()
    scene.restore(state)
    for _ in range(2):
        scene.move_to(scene.pose.moved(z_m=-1.2e-3), ipc_steps=4)
    assert scene.state_hash() == ended
