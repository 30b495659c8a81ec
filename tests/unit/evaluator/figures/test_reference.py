import numpy as np
import pytest
from vitac.evaluator.figures.figures import FORMAT, Variation
from vitac.evaluator.figures.starts import touch_figures
from vitac.evaluator.figures.table import make_reference_looks, reference_design, reference_figures, reference_looks


def test_stored_figures_are_complete_and_of_these_definitions() -> None:
    stored = reference_figures()
    assert stored.format == FORMAT
    assert stored.starts == 90
    assert stored.information is not None
    assert [row.variation for row in stored.robustness] == list(Variation)
    assert {row.episodes for row in stored.robustness} == {90}


def test_what_takes_no_episodes_is_as_measured_now() -> None:
    now, stored = touch_figures(reference_design(), youngs_modulus_pa=3e5, poisson_ratio=0.3), reference_figures().touch
    assert now.model_dump(exclude={"sensitivity"}) == {
        name: pytest.approx(value, rel=1e-3) for name, value in stored.model_dump(exclude={"sensitivity"}).items()
    }
    np.testing.assert_allclose(
        np.array(now.sensitivity.normal_px_n, dtype=float),
        np.array(stored.sensitivity.normal_px_n, dtype=float),
        rtol=1e-3,
    )


def test_stored_looks_are_those_of_the_gel_as_it_is_made_now() -> None:
    assert reference_looks() == make_reference_looks()
