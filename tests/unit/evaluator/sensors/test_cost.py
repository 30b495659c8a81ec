import pytest
from vitac.evaluator.figures.table import reference_figures
from vitac.evaluator.sensors.cost import expected_cpu_s


def test_cost_is_that_of_the_reference_gel() -> None:
    measured = reference_figures().cpu_s
    assert measured is not None
    assert expected_cpu_s(162, episodes=1) == pytest.approx(measured, rel=1 / 3)
