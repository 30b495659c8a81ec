"""The camera rig stands where the facts say (challenge-facts 4.5, 15)."""

import numpy as np
import pytest
from vitac.envs.vision.optics import COLOUR_INTRINSICS, INFRARED_INTRINSICS
from vitac.envs.vision.rig import BASELINE_M, LEFT_INFRARED_X_M, RIGHT_INFRARED_X_M, RigShift, colour_camera_pose


def test_camera_looks_down_at_the_peg_with_its_picture_upside_down() -> None:
    pose = colour_camera_pose(0.03, 0.025)
    right, down, forward = pose.world_from_camera.T
    assert forward == pytest.approx([-0.8064, 0.0, -0.5913], abs=1e-4)
    assert -down[2] == pytest.approx(-0.8064, abs=1e-4)
    assert right == pytest.approx([0.0, -1.0, 0.0])
    assert np.cross(right, down) == pytest.approx(forward)
    assert pose.position_m == pytest.approx([0.371, 0.05, 0.275])


def test_camera_follows_the_peg_in_y_and_z_only() -> None:
    moved = colour_camera_pose(0.04, 0.02).position_m - colour_camera_pose(0.03, 0.025).position_m
    assert moved == pytest.approx([0.0, 0.01, -0.005])


def test_a_shift_turns_and_moves_the_rig() -> None:
    pose = colour_camera_pose(0.03, 0.025, RigShift(turn_rad=0.04, offset_m=(0.01, -0.02, 0.005)))
    nominal = colour_camera_pose(0.03, 0.025)
    cosine = float(pose.world_from_camera[:, 2] @ nominal.world_from_camera[:, 2])
    assert np.arccos(cosine) == pytest.approx(0.04)
    assert pose.position_m - nominal.position_m == pytest.approx([0.01, -0.02, 0.005])


def test_infrared_cameras_are_55_mm_apart_and_see_32_78_pixels_of_disparity_at_one_metre() -> None:
    assert abs(BASELINE_M - 0.055023) < 1e-6
    pose = colour_camera_pose(0.0, 0.0)
    point = pose.position_m + pose.world_from_camera @ [0.01, 0.02, 1.0]
    columns = [
        INFRARED_INTRINSICS.focal_u_px
        * camera.transform_to_camera(point[None])[0, 0]
        / camera.transform_to_camera(point[None])[0, 2]
        for camera in (pose.moved_right(LEFT_INFRARED_X_M), pose.moved_right(RIGHT_INFRARED_X_M))
    ]
    assert columns[0] - columns[1] == pytest.approx(32.78, abs=0.005)


def test_colour_camera_sees_56_degrees_across() -> None:
    assert 2 * np.degrees(np.arctan(320 / COLOUR_INTRINSICS.focal_u_px)) == pytest.approx(55.8, abs=0.05)
