import hashlib

import numpy as np
import pytest
from vitac.evaluator.estimator.regression import Coefficients, Regression, fit

RANDOM = np.random.default_rng(3)
ROWS = RANDOM.normal(2.0, 3.0, (200, 4))
WEIGHTS = np.array([[1.0, 0.0], [0.0, -2.0], [0.5, 0.5], [0.0, 0.0]])
TARGETS = ROWS @ WEIGHTS + (5.0, -1.0)


def test_linear_targets_are_found_up_to_the_ridge() -> None:
    regression = fit(ROWS.tolist(), TARGETS.tolist())
    found = np.array([regression.predict(row) for row in ROWS.tolist()])
    assert np.abs(found - TARGETS).max() < 0.05 * np.ptp(TARGETS)


def test_mean_is_predicted_at_the_mean() -> None:
    regression = fit(ROWS.tolist(), TARGETS.tolist())
    assert regression.predict(ROWS.mean(axis=0).tolist()) == pytest.approx(TARGETS.mean(axis=0).tolist())


def test_variances_are_those_of_the_errors() -> None:
    noise = RANDOM.normal(0.0, (1.0, 3.0), (200, 2))
    regression = fit(ROWS.tolist(), (TARGETS + noise).tolist())
    assert regression.variances == pytest.approx([1.05, 9.05], rel=0.3)


def test_no_estimate_is_certain() -> None:
    regression = fit([[0.0], [1.0], [2.0]], [[1.0], [1.0], [1.0]])
    assert regression.variances == pytest.approx([0.05])


def test_constant_feature_changes_nothing() -> None:
    without = fit(ROWS.tolist(), TARGETS.tolist())
    rows = np.column_stack([ROWS, np.full(len(ROWS), 7.0)]).tolist()
    assert fit(rows, TARGETS.tolist()).predict(rows[0]) == pytest.approx(without.predict(rows[0][:4]))


def test_coefficients_are_named_by_their_bytes() -> None:
    regression = Regression(means=(0.0,), scales=(1.0,), weights=((0.0,), (1.0,)), variances=(1.0,))
    coefficients = Coefficients(mesh_hash="m", starts=2, regressions=(regression,))
    assert coefficients.digest == hashlib.sha256(coefficients.as_bytes()).hexdigest()
    assert Coefficients.model_validate_json(coefficients.as_bytes()) == coefficients
