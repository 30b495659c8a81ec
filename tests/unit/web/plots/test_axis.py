import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.web.plots.axis import Axis, below, beside

NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


def test_values_are_placed_between_its_ends() -> None:
    axis = Axis(low=-4.0, high=4.0, begin=10.0, end=90.0)
    assert [axis.place(value) for value in (-4, 0, 4)] == [10, 50, 90]
    upwards = Axis(low=0.0, high=1.0, begin=100.0, end=0.0)
    assert upwards.place(0.25) == 75


def test_a_single_value_stands_in_the_middle() -> None:
    axis = Axis(low=3.0, high=3.0, begin=0.0, end=100.0)
    assert axis.place(3.0) == 50
    assert axis.ticks() == [3.0]


@given(NUMBERS, st.floats(1e-3, 1e6))
def test_ticks_are_few_round_and_inside(low: float, span: float) -> None:
    axis = Axis(low=low, high=low + span, begin=0.0, end=1.0)
    ticks = axis.ticks()
    assert 1 <= len(ticks) <= 6
    assert all(low - span * 1e-6 <= tick <= low + span * (1 + 1e-6) for tick in ticks)


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [(0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1]), (-4, 4, [-4, -2, 0, 2, 4]), (0, 57, [0, 20, 40]), (1, 8, [2, 4, 6, 8])],
)
def test_ticks_of_plots_here(low: float, high: float, ticks: list[float]) -> None:
    assert Axis(low=low, high=high, begin=0.0, end=1.0).ticks() == ticks


def test_axes_write_their_values() -> None:
    axis = Axis(low=0.0, high=1.0, begin=0.0, end=100.0)
    assert ">20 %</text>" in below(axis, 50.0, lambda value: f"{100 * value:g} %")
    assert beside(axis, 5.0, 90.0).count("<line") == len(axis.ticks())
