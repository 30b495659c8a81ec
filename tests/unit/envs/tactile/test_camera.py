import numpy as np
import pytest
from vitac.envs.tactile.camera import (
    CHALLENGE_CAMERA,
    CameraIntrinsics,
    camera_frame,
    mean_distance_m,
    places_on_faces,
    project,
    weighted_distance_m,
)
from vitac.envs.tactile.gel import gelsight_mini_mesh

NOWHERE = np.zeros(3)
UPRIGHT = np.eye(3)


def test_camera_looks_out_of_the_sensing_face_from_behind() -> None:
    points = np.array([[0.0, 0.0, 0.002], [0.003, 0.0, 0.0], [0.0, 0.004, 0.0]])
    assert camera_frame(points, UPRIGHT, NOWHERE, 0.02) == pytest.approx(
        np.array([[0.0, 0.0, 0.022], [-0.003, 0.0, 0.02], [0.0, -0.004, 0.02]])
    )


def test_rigid_motion_of_gel_and_camera_leaves_the_view_alone() -> None:
    random = np.random.default_rng(1)
    points = random.normal(0.0, 0.01, (20, 3))
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    centre = random.normal(size=3)
    moved = camera_frame(points @ rotation.T + centre, rotation, centre, 0.02)
    assert moved == pytest.approx(camera_frame(points, UPRIGHT, NOWHERE, 0.02), abs=1e-15)


def test_point_on_the_axis_projects_to_the_image_centre() -> None:
    assert project(np.array([[0.0, 0.0, 0.02]]), CHALLENGE_CAMERA).tolist() == [[160.0, 125.0]]
    assert project(np.array([[0.001, -0.001, 0.02]]), CHALLENGE_CAMERA) == pytest.approx(np.array([[177.0, 108.75]]))


def test_sensing_rectangle_fills_the_stated_part_of_the_picture() -> None:
    mesh = gelsight_mini_mesh()
    pixels = project(camera_frame(mesh.rest_position_m[mesh.sensing], UPRIGHT, NOWHERE, 0.02), CHALLENGE_CAMERA)
    assert pixels.min(axis=0) == pytest.approx([11.25, 16.05], abs=0.01)
    assert pixels.max(axis=0) == pytest.approx([308.75, 233.95], abs=0.01)


def test_mean_distance_averages_lengths() -> None:
    first = np.zeros((2, 3))
    second = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert mean_distance_m(first, second) == 3.0


def test_other_intrinsics_and_distances() -> None:
    camera = CameraIntrinsics(focal_u_px=100.0, focal_v_px=200.0, centre_u_px=10.0, centre_v_px=20.0)
    point = camera_frame(np.array([[-0.003, -0.004, 0.002]]), UPRIGHT, NOWHERE, 0.018)
    assert project(point, camera) == pytest.approx(np.array([[10.0 + 100 * 3 / 20, 20.0 + 200 * 4 / 20]]))


def test_weighted_distance_is_the_mean_for_equal_weights() -> None:
    first, second = np.zeros((2, 3)), np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    assert weighted_distance_m(first, second, np.array([0.5, 0.5])) == 3.0
    assert weighted_distance_m(first, second, np.array([0.2, 0.8])) == pytest.approx(1.8)


NODES_M = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [4.0, 4.0, 3.0]])
FACES = np.array([[0, 1, 2], [1, 3, 2]])


def test_places_share_the_area_of_their_faces_evenly() -> None:
    places = places_on_faces(NODES_M, FACES)
    assert places.corners.shape == places.weights.shape == (32, 3)
    assert places.areas_m2[:16] == pytest.approx(np.full(16, 0.5))
    slanted_m2 = 0.5 * np.linalg.norm(np.cross([0.0, 4.0, 3.0], [-4.0, 4.0, 0.0]))
    assert places.areas_m2[16:].sum() == pytest.approx(slanted_m2)


def test_places_are_the_centres_of_sixteen_equal_triangles() -> None:
    places = places_on_faces(NODES_M, FACES)
    np.testing.assert_allclose(places.weights.sum(axis=1), 1.0)
    assert places.weights.min() == pytest.approx(1.0 / 12.0)
    at = (NODES_M[places.corners] * places.weights[:, :, None]).sum(axis=1)[:16, :2]
    assert len(np.unique(at.round(9), axis=0)) == 16
    # The mean of x y over this triangle is 4 / 3; the centres of its parts give it but for the spread in each.
    assert at.mean(axis=0) == pytest.approx([4.0 / 3.0, 4.0 / 3.0])
    assert (at[:, 0] * at[:, 1]).mean() == pytest.approx(4.0 / 3.0, rel=0.04)


def test_chosen_places_keep_what_belongs_to_them() -> None:
    places = places_on_faces(NODES_M, FACES)
    second = places.select(places.corners[:, 1] == 3)
    np.testing.assert_array_equal(second.corners, np.tile(FACES[1], (16, 1)))
    np.testing.assert_array_equal(second.areas_m2, places.areas_m2[16:])
    np.testing.assert_array_equal(second.weights, places.weights[16:])
