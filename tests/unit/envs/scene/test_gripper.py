from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, MotionError, _turned, ipc_steps
from vitac.envs.tactile.gel import gelsight_mini_mesh

POSE = GripperPose(x_m=0.001, y_m=-0.002, z_m=0.0621, angle_rad=0.1, half_opening_m=0.0171)
AHEAD = GripperPose(x_m=0.003, y_m=0.0, z_m=0.06, angle_rad=0.3, half_opening_m=0.0161)
poses = st.builds(
    GripperPose,
    x_m=st.floats(-0.01, 0.01),
    y_m=st.floats(-0.01, 0.01),
    z_m=st.floats(0.05, 0.07),
    angle_rad=st.floats(-0.3, 0.3),
    half_opening_m=st.floats(0.015, 0.018),
)


def gripper(pose: GripperPose = POSE) -> Gripper:
    return Gripper(mounts=UPRIGHT_MOUNTS, gel=gelsight_mini_mesh(), pose=pose)


def test_mounts_are_rotations() -> None:
    for mount in UPRIGHT_MOUNTS:
        assert (mount.rotation @ mount.rotation.T == np.eye(3)).all()
        assert np.linalg.det(mount.rotation) == pytest.approx(1.0)


@given(st.integers(0, 2**32), st.booleans())
def test_points_turn_to_the_bits_of_numpys_sums_of_products(seed: int, is_transposed: bool) -> None:
    random = np.random.default_rng(seed)
    rotation, points = random.normal(size=(3, 3)), random.normal(size=(3, 3) if is_transposed else (5, 3))
    points = points.T if is_transposed else points
    x, y, z = points.T
    expected = np.column_stack([row[0] * x + row[1] * y + row[2] * z for row in rotation])
    assert np.array_equal(_turned(rotation, points), expected)


def test_gel_axes_stand_as_in_the_challenge_at_angle_zero() -> None:
    left, right = (mount.rotation for mount in UPRIGHT_MOUNTS)
    x, y, z = np.eye(3)
    assert (left @ x == -z).all()
    assert (left @ y == x).all()
    assert (left @ z == -y).all()
    assert (right @ x == -z).all()
    assert (right @ y == -x).all()
    assert (right @ z == y).all()


def test_sensing_faces_look_at_each_other() -> None:
    held = gripper()
    left, right = held.sensor_pose(0), held.sensor_pose(1)
    towards = right.centre_m - left.centre_m
    assert left.rotation[:, 2] == pytest.approx(towards / np.linalg.norm(towards))
    assert right.rotation[:, 2] == pytest.approx(-left.rotation[:, 2])


def test_left_sensor_is_at_positive_y_turned_with_the_gripper() -> None:
    offset = 0.0171 * np.array([-sin(0.1), cos(0.1), 0.0])
    centre = np.array([0.001, -0.002, 0.0621])
    assert gripper().sensor_pose(0).centre_m == pytest.approx(centre + offset)
    assert gripper().sensor_pose(1).centre_m == pytest.approx(centre - offset)


@given(poses)
def test_targets_are_the_driven_nodes_at_the_sensor_pose(pose: GripperPose) -> None:
    """What the sensors report as their pose is where the driven nodes are, so nothing has to be fitted."""
    mesh = gelsight_mini_mesh()
    held = gripper(pose)
    targets = held.driven_targets_m(pose)
    for index in range(2):
        sensor = held.sensor_pose(index)
        placed = mesh.rest_position_m[mesh.driven_nodes] @ sensor.rotation.T + sensor.centre_m
        assert np.abs(targets[index] - placed).max() < 1e-16 * 500
        assert sensor.rotation @ sensor.rotation.T == pytest.approx(np.eye(3), abs=1e-15)


def test_targets_of_another_pose_do_not_move_the_gripper() -> None:
    held = gripper()
    held.driven_targets_m(AHEAD)
    assert held.pose == POSE


@given(st.integers(1, 9))
def test_way_is_cut_into_equal_pieces_that_end_at_the_goal(parts: int) -> None:
    way = [POSE.towards(AHEAD, part, parts) for part in range(parts + 1)]
    assert way[0] == POSE
    assert way[-1] == AHEAD
    lengths = np.diff([[pose.x_m, pose.angle_rad, pose.half_opening_m] for pose in way], axis=0)
    assert lengths == pytest.approx(np.tile(lengths[0], (parts, 1)))


def test_moved_turns_about_its_own_centre_and_closes() -> None:
    moved = POSE.moved(x_m=1e-3, z_m=-2e-3, angle_rad=pi / 2, closing_m=1e-4)
    assert (moved.x_m, moved.y_m) == pytest.approx((0.002, -0.002))
    assert moved.z_m == pytest.approx(0.0601)
    assert moved.angle_rad == pytest.approx(0.1 + pi / 2)
    assert moved.half_opening_m == pytest.approx(0.0170)


@pytest.mark.parametrize(
    ("amount", "speed", "time_step_s", "expected"),
    [
        (0.975e-3, 5e-3, 0.1, 2),  # grasp of the peg
        (1.1e-3, 5e-3, 0.1, 2),
        (0.225e-3, 1e-3, 0.1, 2),  # descent before the first env step
        (1.375e-3, 2e-3, 0.2, 3),  # grasp of the key
        (2e-3, 5e-3, 0.1, 4),
        (2.83e-3, 5e-3, 0.1, 6),
        (0.06981317, 0.2, 0.1, 3),  # 4 degrees
        (0.125e-3, 5e-3, 0.1, 1),
        (2e-3, 2e-3, 0.2, 5),
        (0.0, 5e-3, 0.1, 1),
    ],
)
def test_counts_are_those_of_the_2025_code(amount: float, speed: float, time_step_s: float, expected: int) -> None:
    assert ipc_steps(amount, speed_per_s=speed, time_step_s=time_step_s) == expected


def test_ties_go_to_the_even_count() -> None:
    assert ipc_steps(2.5, speed_per_s=1.0, time_step_s=1.0) == 2
    assert ipc_steps(3.5, speed_per_s=1.0, time_step_s=1.0) == 4


@given(st.floats(-10, 10))
def test_sign_does_not_matter_and_one_is_the_least(amount: float) -> None:
    count = ipc_steps(amount, speed_per_s=1.0, time_step_s=0.1)
    assert count == ipc_steps(-amount, speed_per_s=1.0, time_step_s=0.1) >= 1


@pytest.mark.parametrize(("speed", "time_step_s"), [(0.0, 0.1), (1.0, 0.0), (-1.0, 0.1)])
def test_refuses_a_speed_or_time_step_that_is_not_positive(speed: float, time_step_s: float) -> None:
    with pytest.raises(MotionError, match="must be positive"):
        ipc_steps(1.0, speed_per_s=speed, time_step_s=time_step_s)
