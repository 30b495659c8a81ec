"""Weights and loads of parts: how they fall and turn, stand, hang in a grasp by friction, and slip out of it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from block_meshes import box_gel
from numpy.typing import NDArray
from small_scenes import IDENTITY, driven_positions_m
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GEL_MATERIAL, PART_MATERIAL, GelBody, GelMesh, PointLoad, PointMass, RigidBody
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, Stopwatch, fixed_at_origin
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from vitac.envs.tactile.gel import coarse_arena_gel_mesh, highest_mm
from vitac.envs.tactile.markers import MarkerSettings

FloatArray = NDArray[np.float64]
GRAVITY = (0.0, 0.0, -9.81)
SOLID_KG, WEIGHT_KG, AT_MM = 0.1, 0.3, np.array([6.0, 3.0, 10.0])
FRICTION = 0.7


def block(low_mm: float = 0.0, **options: Any) -> RigidBody:
    """A block of 100 g, 24 x 30 x 50 mm."""
    mesh = solid_from_faces(prism_faces(rectangle(-12.0, 12.0, -15.0, 15.0), 0.0, 50.0), "block")
    return RigidBody(
        mesh=mesh,
        rotation=np.eye(3),
        translation_m=np.array([0.0, 0.0, 1e-3 * low_mm]),
        density_kg_m3=SOLID_KG / mesh.volume_m3,
        **options,
    )


def alone(body: RigidBody, **options: Any) -> tuple[Scene, list[FloatArray]]:
    """A scene in which nothing else is near, and the targets of its gel."""
    gel = GelBody(mesh=box_gel((0.004, 0.004, 0.004), (1, 1, 2)), rotation=IDENTITY, translation_m=np.full(3, 9.0))
    return Scene(gels=[gel], bodies=[body], time_step_s=0.01, **options), [driven_positions_m(gel)]


def test_a_part_falls_as_far_as_gravity_says_and_does_not_turn() -> None:
    body = block(point_masses=(PointMass(WEIGHT_KG, 1e-3 * AT_MM),))
    scene, targets = alone(body, gravity_m_s2=GRAVITY)
    start = scene.body_vertices_m(0)
    for _ in range(5):
        scene.step(driven_targets_m=targets)
    fallen = np.array(GRAVITY) * 0.01**2 * (1 + 2 + 3 + 4 + 5)
    assert np.abs(scene.body_vertices_m(0) - start - fallen).max() < 1e-9


def test_a_load_moves_the_centre_of_mass_and_turns_the_part_about_it() -> None:
    body = block(point_masses=(PointMass(WEIGHT_KG, 1e-3 * AT_MM),))
    scene, targets = alone(body)
    start, force, place = scene.body_vertices_m(0), np.array([0.0, 0.0, -2e-3]), np.array([12e-3, 0.0, 50e-3])
    scene.step(driven_targets_m=targets, loads={0: PointLoad(force, place)})
    moved = scene.body_vertices_m(0) - start
    mass, middle = SOLID_KG + WEIGHT_KG, np.array([0.0, 0.0, 25e-3])
    centre = (SOLID_KG * middle + WEIGHT_KG * 1e-3 * AT_MM) / mass
    inertia = SOLID_KG / 12.0 * np.diag([30.0**2 + 50.0**2, 24.0**2 + 50.0**2, 24.0**2 + 30.0**2]) * 1e-6
    for kg, apart in ((SOLID_KG, middle - centre), (WEIGHT_KG, 1e-3 * AT_MM - centre)):
        inertia += kg * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    turn = np.linalg.solve(inertia, np.cross(place - centre, force)) * 0.01**2
    expected = force / mass * 0.01**2 + np.cross(turn, body.mesh.vertices_m - centre)
    assert np.abs(moved - expected).max() < 1e-3 * np.abs(expected).max()


def test_weights_and_loads_are_refused_where_nothing_moves() -> None:
    for options in ({"point_masses": (PointMass(0.1, np.zeros(3)),)}, {"load": lambda _: None}):
        with pytest.raises(SceneError, match="body 0 has a load or point masses, but is fixed"):
            alone(block(fixed=True, **options))
    with pytest.raises(SceneError, match="mass_kg of a point mass of body 0 is 0"):
        alone(block(point_masses=(PointMass(0.0, np.zeros(3)),)))
    with pytest.raises(SceneError, match="gravity_m_s2 is"):
        alone(block(), gravity_m_s2=(0.0, 0.0, np.nan))
    scene, targets = alone(block())
    with pytest.raises(SceneError, match="expected finite numbers"):
        scene.step(driven_targets_m=targets, loads={0: PointLoad(np.array([0.0, 0.0, np.inf]), np.zeros(3))})


def gripped(
    load: Callable[[float], PointLoad] | None = None,
    *,
    gel: GelMesh | None = None,
    low_mm: float = 3.0,
    indentation_mm: float = 0.3,
    time_step_s: float = 0.1,
) -> GraspedScene:
    """A block of 0.4 kg between two gels above a table."""
    meshes = Meshes(gel=gel, is_arena=True)
    frictions = (
        PairFriction(first=GEL_MATERIAL, second=PART_MATERIAL, coefficient=FRICTION),
        PairFriction(first=PART_MATERIAL, second=PART_MATERIAL, coefficient=0.3),
        PairFriction(first=GEL_MATERIAL, second=GEL_MATERIAL, coefficient=1.0),
    )
    pose = GripperPose(
        x_m=0.0,
        y_m=0.0,
        z_m=1e-3 * (low_mm + 30.0),
        angle_rad=0.0,
        half_opening_m=1e-3 * (15.0 + highest_mm(meshes.gel()) - 0.02),
    )
    scene = GraspedScene(
        gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=pose.moved(closing_m=-0.04e-3)),
        held=block(low_mm, point_masses=(PointMass(WEIGHT_KG, np.array([0.0, 0.0, 25e-3])),), load=load),
        fixed=fixed_at_origin(
            solid_from_faces(prism_faces(rectangle(-40.0, 40.0, -30.0, 30.0), -5.0, 0.0), "table"), friction=0.5
        ),
        physics=PhysicsSettings(
            contact=ArenaContactSettings(pair_frictions=frictions),
            poisson_ratio=0.48,
            gravity_m_s2=-GRAVITY[2],
            time_step_s=time_step_s,
        ),
        sensors=meshes.sensors(MarkerSettings()),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    scene.move_to(scene.pose.moved(closing_m=1e-3 * (indentation_mm + 0.02)), ipc_steps=3)
    return scene


def downwards(force_n: Callable[[float], float]) -> Callable[[float], PointLoad]:
    """A load through the middle of the block that is so large at a time."""
    return lambda time_s: PointLoad(np.array([0.0, 0.0, -force_n(time_s)]), np.array([0.0, 0.0, 25e-3]))


def height_m(scene: GraspedScene) -> float:
    return float(scene.held_vertices_m(np.arange(8))[:, 2].mean())


def carried_n(scene: GraspedScene) -> float:
    """What the gels hold of the block."""
    return -float(scene.contact_forces_n()[0, 2])


WEIGHT_N = -GRAVITY[2] * (SOLID_KG + WEIGHT_KG)


def test_a_part_stands_on_the_table_with_its_weight_and_its_load() -> None:
    scene = gripped(downwards(lambda time_s: 5.0 * (time_s > 0.75)), low_mm=0.05, indentation_mm=-0.3)
    for load_n in (0.0, 5.0):
        scene.move_to(scene.pose, ipc_steps=4)
        assert scene.force_on_held_n(3) == pytest.approx([0.0, 0.0, WEIGHT_N + load_n], abs=1e-3)
        assert carried_n(scene) == pytest.approx(0.0, abs=1e-3)
    assert scene.held_vertices_m(np.arange(8))[:, 2].min() > 0.0


def test_what_friction_holds_does_not_creep() -> None:
    scene = gripped(downwards(lambda time_s: min(10.0, 20.0 * time_s)), indentation_mm=0.1)
    scene.move_to(scene.pose, ipc_steps=10)
    assert carried_n(scene) == pytest.approx(WEIGHT_N + 10.0, abs=2e-3)
    assert 0.5 < carried_n(scene) / (2.0 * FRICTION * scene.grip_force_n()) < 0.8
    before_m = height_m(scene)
    scene.move_to(scene.pose, ipc_steps=300)
    assert scene.solved
    assert abs(height_m(scene) - before_m) < 1e-8, "in half a minute"


@pytest.mark.parametrize(
    ("time_step_s", "gel", "slips_at_n"),
    [(0.05, None, 17.7), (0.025, None, 17.7), (0.05, coarse_arena_gel_mesh(), 16.7)],
    ids=["step of 50 ms", "step halved", "mesh of half as many cells"],
)
def test_a_part_slips_where_its_load_leaves_the_friction_cone(
    time_step_s: float, gel: GelMesh | None, slips_at_n: float
) -> None:
    scene = gripped(
        downwards(lambda time_s: 10.0 + 5.0 * (time_s - 1.0) if time_s > 1.0 else 10.0 * time_s),
        time_step_s=time_step_s,
        gel=gel,
        low_mm=30.0,
        indentation_mm=0.1,
    )
    below_n, start_m = 0.0, height_m(scene)
    while start_m - height_m(scene) < 2e-3:
        scene.move_to(scene.pose, ipc_steps=1)
        assert scene.solved
        loaded_n = WEIGHT_N + 10.0 * min(1.0, scene.time_s) + 5.0 * max(0.0, scene.time_s - 1.0)
        share = carried_n(scene) / (2.0 * FRICTION * scene.grip_force_n())
        if start_m - height_m(scene) < 1e-3:
            below_n = loaded_n
            assert share < 1.0
            assert carried_n(scene) == pytest.approx(loaded_n, abs=0.03), "it hangs"
    assert share == pytest.approx(1.0, abs=0.015), "it slides"
    assert carried_n(scene) < loaded_n
    assert below_n - 0.1 < slips_at_n < loaded_n + 0.5


def test_a_cycle_of_load_costs_energy_and_leaves_the_part_where_it_was() -> None:
    scene = gripped(
        downwards(lambda time_s: max(0.0, 10.0 - 10.0 * abs(time_s - 1.3))), indentation_mm=0.1, time_step_s=0.05
    )
    scene.move_to(scene.pose, ipc_steps=3)
    start_m, work_j, stored_j = height_m(scene), 0.0, 0.0
    while scene.time_s < 2.4:
        before_m, before_n = height_m(scene), carried_n(scene) - WEIGHT_N
        scene.move_to(scene.pose, ipc_steps=1)
        assert scene.solved
        work_j += 0.5 * (before_n + carried_n(scene) - WEIGHT_N) * (before_m - height_m(scene))
        stored_j = max(stored_j, work_j)
    assert 0.0 < work_j < 0.2 * stored_j
    assert start_m - height_m(scene) < 0.05e-3
