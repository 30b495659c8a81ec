import numpy as np
import pytest
from vitac.envs.tactile.places import places_on_faces

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
