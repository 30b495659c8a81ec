from functools import cache

import numpy as np
import own_sensors
import pytest
from vitac.envs.tactile.response import Response, compute_response

YOUNGS_MODULUS_PA, POISSON_RATIO = 3e5, 0.3


@cache
def response(youngs_modulus_pa: float = YOUNGS_MODULUS_PA) -> Response:
    return compute_response(
        own_sensors.designed("4 mm"), youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=POISSON_RATIO
    )


def everywhere() -> np.ndarray:
    return np.ones((len(response().points_mm), 1))


def motion(of: Response, axis: int) -> np.ndarray:
    """Of all markers under 1 N along an axis that is spread over the whole face, shape [m, 2] [px]."""
    return np.asarray(of.motion_px_n(everywhere())[:, axis, 0].reshape(2, -1).T)


def test_places_share_out_the_area_of_the_sensing_faces() -> None:
    found = response()
    assert found.areas_mm2.sum() == pytest.approx(25.25 * 20.75, rel=1e-5)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0)
    assert found.weights.min() >= 0.0
    centre_mm = (found.points_mm * found.areas_mm2[:, None]).sum(axis=0) / found.areas_mm2.sum()
    np.testing.assert_allclose(centre_mm, 0.0, atol=1e-9)


def test_shear_moves_markers_as_a_sheared_layer_does() -> None:
    """A wide layer under a shear stress moves by F h / (A G) at its face; near the rim of ours by more."""
    shear_modulus_pa = YOUNGS_MODULUS_PA / (2.0 * (1.0 + POISSON_RATIO))
    expected_m = 4e-3 / (25.25e-3 * 20.75e-3 * shear_modulus_pa)
    # The camera, 22 mm away, sees x and y the other way round.
    for axis, focal_px in ((0, 340.0), (1, 325.0)):
        along = np.median(motion(response(), axis)[:, axis])
        assert -along * 22e-3 / focal_px == pytest.approx(expected_m, rel=0.15)


def test_half_the_stiffness_gives_twice_the_motion() -> None:
    np.testing.assert_allclose(
        motion(response(0.5 * YOUNGS_MODULUS_PA), 2), 2.0 * motion(response(), 2), rtol=1e-9, atol=1e-15
    )


def test_each_pressure_is_scaled_to_1_n() -> None:
    found = response()
    both = found.motion_px_n(np.hstack([everywhere(), 7.0 * everywhere()]))
    np.testing.assert_allclose(both[:, :, 0], both[:, :, 1], rtol=1e-12)


def test_pin_moves_the_markers_around_it_most() -> None:
    found, markers = response(), own_sensors.designed("4 mm").markers_mm
    for place in (300, 700):
        load = np.eye(len(found.points_mm))[:, [place]]
        moved = found.motion_px_n(load)[:, 0, 0].reshape(2, -1)
        near = np.hypot(*(found.points_mm[place] - markers).T) < 3.0
        lengths = np.hypot(*moved)
        assert lengths[near].min() > np.median(lengths)
