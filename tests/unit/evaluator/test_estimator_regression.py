import hashlib

import numpy as np
import pytest
from vitac.evaluator.regression import Coefficients, Regression, fit

RANDOM = np.random.default_rng(3)
ROWS = RANDOM.normal(2.0, 3.0, (200, 4))
WEIGHTS = np.array([[1.0, 0.0], [0.0, -2.0], [0.5, 0.5], [0.0, 0.0]])
TARGETS = ROWS @ WEIGHTS + (5.0, -1.0)


def test_linear_targets_are_found_up_to_the_ridge() -> None:
    regression = fit(ROWS.tolist(), TARGETS.tolist())
    found = np.array([regression.predict(row) for row in ROWS.tolist()])
    assert np.abs(found - TARGETS).max() < 0.05 * np.ptp(TARGETS)


def test_coefficients_are_named_by_their_bytes() -> None:
    regression = Regression(means=(0.0,), scales=(1.0,), weights=((0.0,), (1.0,)), variances=(1.0,))
    coefficients = Coefficients(mesh_hash="m", starts=2, regressions=(regression,))
    assert coefficients.digest == hashlib.sha256(coefficients.as_bytes()).hexdigest()
    assert Coefficients.model_validate_json(coefficients.as_bytes()) == coefficients


def test_weights_are_those_of_the_closed_form() -> None:
    found = fit(ROWS.tolist(), TARGETS.tolist())
    n = len(ROWS)
    standard = (ROWS - ROWS.mean(axis=0)) / ROWS.std(axis=0)
    expected = np.linalg.solve(standard.T @ standard + 0.03 * n * np.eye(4), standard.T @ TARGETS)
    np.testing.assert_allclose(found.weights[1:], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.weights[0], TARGETS.mean(axis=0), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.means, ROWS.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.scales, ROWS.std(axis=0), rtol=1e-12)


def test_errors_are_those_of_the_fitted_rows() -> None:
    found = fit(ROWS.tolist(), TARGETS.tolist())
    errors = np.array([found.predict(row) for row in ROWS.tolist()]) - TARGETS
    np.testing.assert_allclose(found.variances, (errors**2).mean(axis=0) + 0.05, rtol=1e-9)


def test_a_feature_that_never_changes_has_a_scale_of_one() -> None:
    found = fit([[7.0, 1.0], [7.0, 2.0], [7.0, 3.0]], [[1.0], [2.0], [3.0]])
    assert found.scales[0] == 1.0
    assert found.weights[1] == pytest.approx((0.0,))
    assert found.predict([9.0, 2.0]) == pytest.approx([2.0])


@pytest.mark.parametrize("features", [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 4.0, 5.0], []])
def test_another_number_of_features_is_an_error(features: list[float]) -> None:
    with pytest.raises(ValueError, match="argument"):
        fit(ROWS.tolist(), TARGETS.tolist()).predict(features)
