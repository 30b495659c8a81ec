from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.contact.forces import no_forces
from vitac.envs.fem.model.mesh import PronyBranch, RigidBody
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, Stopwatch
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from vitac.envs.scene.measured_pose import held_pose_mm_deg, rigid_fit
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tasks.peg_insertion.env import hole_mesh, peg_mesh

POSE = GripperPose(x_m=0.0, y_m=0.0, z_m=0.0621, angle_rad=0.0, half_opening_m=0.0171)


def scene(*others: RigidBody, **markers: Any) -> GraspedScene:
    meshes = Meshes()

    def placed(fixed: bool) -> RigidBody:
        mesh = hole_mesh(meshes, PegShape.CUBOID) if fixed else peg_mesh(meshes, PegShape.CUBOID)
        return RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.zeros(3), fixed=fixed)

    return GraspedScene(
        gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=POSE),
        held=placed(False),
        fixed=placed(True),
        physics=PhysicsSettings(),
        sensors=meshes.sensors(MarkerSettings(**markers)),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
        others=others,
    )


def test_further_parts_follow_the_others_and_the_fixed_ones_are_one_surface(fake_scenes: list[FakeScene]) -> None:
    mesh = peg_mesh(Meshes(), PegShape.CUBOID)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    still = RigidBody(mesh=mesh, rotation=turned, translation_m=np.array([0.1, 0.0, 0.0]), fixed=True)
    loose = RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.array([0.0, 0.2, 0.0]))
    made = scene(still, loose)
    assert fake_scenes[0].bodies == [made.held, made.fixed, still, loose]
    assert made.other_vertices_m(1) == pytest.approx(mesh.vertices_m + loose.translation_m)
    surface, first = made.fixed_surface(), len(made.fixed.mesh.vertices_m)
    assert (surface.vertices_m[:first] == made.fixed.mesh.vertices_m).all()
    assert surface.vertices_m[first:] == pytest.approx(mesh.vertices_m @ turned.T + still.translation_m)
    assert surface.volume_m3 == pytest.approx(made.fixed.mesh.volume_m3 + mesh.volume_m3)


def test_force_of_one_body_on_the_held_part_counts_contacts_either_way(
    fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = peg_mesh(Meshes(), PegShape.CUBOID)
    made = scene(RigidBody(mesh=mesh, rotation=np.eye(3), translation_m=np.array([0.1, 0.0, 0.0])))
    bodies, forces_n = np.array([[2, 3], [3, 2], [0, 2], [2, 4]]), np.arange(1.0, 5.0)[:, None] * np.eye(1, 3, 2)
    contacts = no_forces()._replace(bodies=bodies, points_m=np.zeros((4, 3)), forces_n=forces_n)
    monkeypatch.setattr(fake_scenes[0], "contact_forces", lambda: contacts)
    assert [made.force_on_held_n(body).tolist() for body in (3, 4)] == [[0.0, 0.0, 1.0 - 2.0], [0.0, 0.0, 4.0]]


def test_gels_are_placed_at_the_sensor_poses_with_the_materials(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    left, right = fake_scenes[0].gels
    centres_m = np.stack([made.sensor_pose(index).centre_m for index in range(2)])
    assert np.stack([left.translation_m, right.translation_m]) == pytest.approx(centres_m)
    assert centres_m == pytest.approx(np.array([[0, 0.0171, 0.0621], [0, -0.0171, 0.0621]]))
    assert (left.youngs_modulus_pa, left.poisson_ratio, left.density_kg_m3, left.friction) == (3e5, 0.3, 1e3, 87.5)
    assert fake_scenes[0].time_step_s == 0.1
    assert fake_scenes[0].contact.d_hat_m == 1e-4


def test_motion_is_cut_into_ipc_steps_that_end_at_the_goal(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    goal = POSE.moved(x_m=4e-3)
    made.move_to(goal, ipc_steps=4)
    means_m = [np.mean(targets, axis=(0, 1))[0] for targets in fake_scenes[0].targets_m]
    assert means_m == pytest.approx([1e-3, 2e-3, 3e-3, 4e-3])
    assert made.pose == goal
    assert made.ipc_steps == 4


def test_rigid_motion_is_no_surface_motion(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.capture_references()
    made.move_to(POSE.moved(x_m=3e-3, y_m=1e-3, angle_rad=0.2), ipc_steps=3)
    assert made.surface_diff_m() == pytest.approx([0.0, 0.0], abs=1e-15)


def test_bulged_surface_is_measured_in_both_sensors(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.capture_references()
    fake_scenes[0].bulge_m = 4e-4
    made.move_to(POSE.moved(x_m=1e-3), ipc_steps=1)
    assert made.surface_diff_m() == pytest.approx([4e-4, 4e-4])


def test_what_the_sensors_see_is_made_once_between_two_ipc_steps(
    fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = scene()
    seen: list[int] = []
    nodes_m = made.gel_nodes_m

    def looked_at(index: int) -> NDArray[np.float64]:
        seen.append(index)
        return nodes_m(index)

    monkeypatch.setattr(made, "gel_nodes_m", looked_at)
    made.capture_references()
    made.surface_diff_m()
    made.marker_flow(np.random.default_rng(3))
    assert seen == [0, 1]
    made.move_to(POSE.moved(x_m=1e-3), ipc_steps=2)
    made.surface_diff_m()
    made.surface_diff_m()
    assert seen == [0, 1, 0, 1]


def test_surface_motion_is_that_since_the_newest_reference(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.capture_references()
    fake_scenes[0].bulge_m = 4e-4
    made.move_to(POSE.moved(x_m=1e-3), ipc_steps=1)
    first = made.surface_diff_m()
    first *= 1e3  # whoever gets it may change it
    assert made.surface_diff_m() == pytest.approx([4e-4, 4e-4])
    made.capture_references()
    assert made.surface_diff_m().tolist() == [0.0, 0.0]


def test_marker_flow_is_left_then_right_in_float32(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.capture_references()
    flow = made.marker_flow(np.random.default_rng(3))
    assert flow.shape == (2, 2, 128, 2)
    assert flow.dtype == np.float32
    assert not np.array_equal(flow[0], flow[1])
    again = made.marker_flow(np.random.default_rng(3))
    assert np.array_equal(flow, again)


def test_step_that_does_not_converge_stops_all_motion(
    fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FakeScene, "statuses", [StepStatus.DIVIDED, StepStatus.NOT_CONVERGED])
    made = scene()
    made.move_to(POSE.moved(x_m=4e-3), ipc_steps=4)
    assert not made.solved
    assert made.ipc_steps == 2
    made.move_to(POSE, ipc_steps=1)
    assert made.ipc_steps == 2
    assert [report.status for report in made.take_reports()] == ["divided", "not_converged"]
    assert made.take_reports() == ()


def test_held_vertices_are_those_of_the_first_body(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.move_to(POSE.moved(z_m=-1e-3), ipc_steps=1)
    chosen = np.array([0, 3])
    rest = peg_mesh(Meshes(), PegShape.CUBOID).vertices_m[chosen]
    assert made.held_vertices_m(chosen) == pytest.approx(rest - np.array([0, 0, 1e-3]))


def test_held_part_is_placed_once_between_two_ipc_steps(
    fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = scene()
    physics, placed = fake_scenes[0], []
    vertices_m = physics.body_vertices_m

    def looked_at(index: int) -> NDArray[np.float64]:
        placed.append(made.ipc_steps)
        return vertices_m(index)

    monkeypatch.setattr(physics, "body_vertices_m", looked_at)
    all_vertices = np.arange(4)
    for _ in range(2):
        made.held_vertices_m(all_vertices)[:] = np.nan  # whoever gets them may change them
    first_m = made.held_vertices_m(all_vertices)
    made.move_to(POSE.moved(z_m=-1e-3), ipc_steps=2)
    assert made.held_vertices_m(all_vertices[:2]) == pytest.approx(first_m[:2] - np.array([0, 0, 1e-3]))
    assert placed == [0, 2]


def test_state_hash_follows_the_state(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    before = made.state_hash()
    assert before == made.state_hash() == scene().state_hash()
    made.move_to(POSE.moved(z_m=-1e-3), ipc_steps=1)
    assert made.state_hash() != before


def test_a_listener_is_called_after_every_ipc_step(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    heights_m: list[float] = []
    made.after_ipc_step = lambda: heights_m.append(made.pose.z_m)
    made.move_to(POSE.moved(z_m=-2e-3), ipc_steps=2)
    assert heights_m == pytest.approx([0.0611, 0.0601])


def test_scene_shows_its_parts_and_gels(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    assert made.held_surface.name == "cuboid peg"
    assert made.fixed.mesh.name == "cuboid hole"
    assert made.gel is Meshes().gel()
    assert made.physics == PhysicsSettings()
    left = made.sensor_pose(0)
    rest = made.gel.rest_position_m
    assert made.gel_nodes_m(0) == pytest.approx(rest @ left.rotation.T + left.centre_m)


def test_surfaces_are_told_without_noise_as_the_cameras_see_them(fake_scenes: list[FakeScene]) -> None:
    made = scene()
    made.capture_references()
    made.move_to(POSE.moved(x_m=3e-3), ipc_steps=1)
    FakeScene.bulge_m = 1e-4
    points_m = made.surface_points_m()
    assert points_m.shape == (2, 2, 49, 3)
    assert points_m[:, 0, :, 2] == pytest.approx(np.full((2, 49), 22e-3))
    moved_m = points_m[:, 1] - points_m[:, 0]
    assert moved_m == pytest.approx(np.tile([0.0, 0.0, 1e-4], (2, 49, 1)), abs=1e-12)


def test_measured_pose_is_that_of_the_part_and_not_of_the_gripper() -> None:
    made = scene()
    angles = np.radians([2.0, -3.0, 15.0])
    turned = turn(2, angles[2]) @ turn(1, angles[1]) @ turn(0, angles[0])
    rest_m = made.held_surface.vertices_m
    rotation, moved_m = rigid_fit(rest_m, rest_m @ turned.T + [1e-3, -2e-3, 20e-3])
    assert rotation == pytest.approx(turned)
    assert moved_m == pytest.approx([1e-3, -2e-3, 20e-3])
    made.held_vertices_m = lambda vertices: (rest_m @ turned.T + [1e-3, -2e-3, 20e-3])[vertices]  # type: ignore[method-assign]
    assert held_pose_mm_deg(made) == pytest.approx([1.0, -2.0, 20.0, 2.0, -3.0, 15.0])


def test_mirror_image_is_no_rotation() -> None:
    points_m = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    rotation, _ = rigid_fit(points_m, points_m * [1.0, 1.0, -1.0])
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def turn(axis: int, angle_rad: float) -> np.ndarray:
    """Rotation about x, y or z."""
    turned = np.eye(3)
    after, last = (axis + 1) % 3, (axis + 2) % 3
    turned[[after, last], [after, last]] = np.cos(angle_rad)
    turned[last, after], turned[after, last] = np.sin(angle_rad), -np.sin(angle_rad)
    return turned


def scene_with(**markers: Any) -> GraspedScene:
    return scene(noise_px=0.0, loss_probability=0.0, **markers)


def flow_after_bulge(made: GraspedScene, physics: FakeScene) -> NDArray[np.float64]:
    """The motion of the markers after an env step of two IPC steps, whose second one pushes the gels out."""
    made.capture_references()
    made.begin_env_step()
    made.move_to(POSE, ipc_steps=1)
    physics.bulge_m = 4e-4
    made.move_to(POSE, ipc_steps=1)
    flow = made.marker_flow(np.random.default_rng(1)).astype(np.float64)
    return np.asarray(flow[:, 1] - flow[:, 0])


def test_delayed_touch_lies_between_two_moments_of_the_env_step(fake_scenes: list[FakeScene]) -> None:
    now, quarter, half, whole = (
        flow_after_bulge(made, fake_scenes[-1]) for delay in (0.0, 0.25, 0.5, 1.0) for made in [scene_with(delay=delay)]
    )
    assert np.abs(now).max() > 1.0
    assert quarter == pytest.approx(0.5 * now, abs=0.05)  # 0.25 of two IPC steps is half of the last one
    assert half == pytest.approx(0.0, abs=1e-4)
    assert whole == pytest.approx(0.0, abs=1e-4)


def test_delayed_touch_is_the_same_after_going_back_to_a_state(fake_scenes: list[FakeScene]) -> None:
    made = scene_with(delay=0.25)
    expected = flow_after_bulge(made, fake_scenes[-1])
    fake_scenes[-1].state = lambda: None  # type: ignore[attr-defined]
    fake_scenes[-1].restore = lambda _: None  # type: ignore[attr-defined]
    state = made.state()
    made.begin_env_step()
    made.restore(state)
    flow = made.marker_flow(np.random.default_rng(1))
    assert np.array_equal(flow[:, 1] - flow[:, 0], expected.astype(np.float32))


def test_drift_grows_with_the_simulated_time_and_is_the_same_for_all_markers(fake_scenes: list[FakeScene]) -> None:
    made = scene_with(drift_v_px_s=2.0)
    made.capture_references()
    made.move_to(POSE, ipc_steps=5)
    flow = made.marker_flow(np.random.default_rng(1))
    assert flow[:, 1, :, 0] == pytest.approx(flow[:, 0, :, 0], abs=1e-3)
    assert flow[:, 1, :, 1] - flow[:, 0, :, 1] == pytest.approx(1.0, abs=1e-3)  # 2 px/s over 5 x 0.1 s


def test_sums_the_time_within_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([1.0, 1.5, 10.0, 12.0])
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.thread_time", lambda: next(ticks))
    watch = Stopwatch()
    with watch:
        pass
    with watch:
        pass
    assert watch.elapsed_s == 2.5


def test_counts_a_block_that_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([0.0, 3.0])
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.thread_time", lambda: next(ticks))
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch:
        raise ZeroDivisionError
    assert watch.elapsed_s == 3.0


def test_viscosity_is_in_the_settings_text_that_is_hashed_only_where_there_is_any() -> None:
    """The mesh hashes of results without viscosity stay as they were before it could be set."""
    plain = repr(PhysicsSettings())
    assert plain.startswith("PhysicsSettings(time_step_s=0.1, contact=ContactSettings(d_hat_m=0.0001, kappa=100.0, ")
    assert plain.endswith(", gel_density_kg_m3=1000.0, gel_friction=87.5, rigid_density_kg_m3=500.0)")
    branch = PronyBranch(modulus_ratio=0.5, relaxation_time_s=2.0)
    assert repr(PhysicsSettings(viscosity=(branch,))) == f"{plain[:-1]}, viscosity=({branch!r},))"


def test_the_wrench_on_the_gripper_is_in_its_axes_and_about_a_point_above_it(
    fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One force of 2 N downwards and 1 N along the world's x, on a node of the left gel."""
    made = scene()
    node = int(made.gel.sensing_nodes[10])
    on_nodes_n = [np.zeros_like(made.gel.rest_position_m) for _ in range(2)]
    on_nodes_n[0][node] = [1.0, 0.0, -2.0]
    monkeypatch.setattr(fake_scenes[0], "gel_contact_forces_n", lambda: on_nodes_n)
    made.move_to(POSE.moved(x_m=0.01, angle_rad=0.5 * np.pi), ipc_steps=1)
    arm_m = made.gel_nodes_m(0)[node] - np.array([0.01, 0.0, POSE.z_m + 0.15])
    moment_n_m = np.cross(arm_m, [1.0, 0.0, -2.0])
    # The gripper's x is the world's y, its y is against the world's x.
    expected = [0.0, -1.0, -2.0, moment_n_m[1], -moment_n_m[0], moment_n_m[2]]
    assert made.wrench_on_gripper(0.15) == pytest.approx(expected, abs=1e-12)
    assert abs(moment_n_m[1]) > 0.1
