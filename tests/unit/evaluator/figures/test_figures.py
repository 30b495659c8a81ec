import itertools
import math

import pytest
from measured_figures import GRASP, TOUCH, diagonal, start
from vitac.evaluator.figures.figures import (
    FiguresPart,
    Variation,
    expected_information,
    merged,
    rounded,
)

# Independent axes with variances 4, 1 and 25.
OFFSETS = [(2.0 * x, float(y), 5.0 * t) for x, y, t in itertools.product((-1, 1), repeat=3)]


def test_information_of_independent_axes_is_that_of_each() -> None:
    one, two, three = diagonal(0.75, 3.0, 0.0), diagonal(3.75, 15.0, 0.0), diagonal(3.75, 15.0, 0.6)
    found = expected_information([(one, two, three)], OFFSETS)
    assert found is not None
    # Per axis 1/2 log2(1 + variance x information): 4, 4, 1, then 16, 16, 1, then 16, 16, 16.
    assert found.bits == pytest.approx((2.0, 4.0, 6.0))
    assert found.prior == pytest.approx((2.0, 1.0, 5.0))
    assert found.bounds == pytest.approx((0.5, 0.25, 1.25))


def test_information_is_averaged_over_the_starts() -> None:
    nothing, much = diagonal(0.0, 0.0, 0.0), diagonal(0.75, 3.0, 0.12)
    found = expected_information([(nothing,) * 3, (much,) * 3], OFFSETS)
    assert found is not None
    assert found.bits == pytest.approx((1.5, 1.5, 1.5))
    assert found.bounds == pytest.approx(tuple(math.sqrt(0.5 * (v + v / 4)) for v in (4.0, 1.0, 25.0)), rel=1e-4)
    assert expected_information([], OFFSETS) is None


def test_parts_are_put_together_in_any_order() -> None:
    first = FiguresPart(starts=(start(1, won=True), start(5, won=False, det_f=0.6)), touch=TOUCH, grasp=GRASP)
    second = FiguresPart(starts=(start(2, won=False, cpu_s=0.4),))
    found = merged([first, second], OFFSETS)
    assert found is not None
    assert found == merged([second, first], OFFSETS)
    assert found.starts == 3
    assert found.grasp.smallest_det_f == 0.6
    assert [(row.variation, row.successes, row.episodes) for row in found.robustness] == [
        (Variation.NONE, 3, 3),
        (Variation.NOISE, 1, 3),
    ]
    assert found.robustness[1].success_rate == pytest.approx(1 / 3)
    assert found.cpu_s == pytest.approx(0.2)


def test_start_that_was_measured_twice_counts_once() -> None:
    part = FiguresPart(starts=(start(1, won=True),), touch=TOUCH, grasp=GRASP)
    found = merged([part, part], OFFSETS)
    assert found is not None
    assert found.starts == 1


def test_figures_that_take_no_episodes_stand_alone() -> None:
    found = merged([FiguresPart(starts=(), touch=TOUCH, grasp=GRASP)], OFFSETS)
    assert found is not None
    assert (found.starts, found.information, found.robustness, found.cpu_s) == (0, None, (), None)
    assert found.grasp == GRASP


def test_parts_without_the_sensor_as_a_whole_or_of_other_definitions_give_none() -> None:
    assert merged([FiguresPart(starts=(start(1, won=True),))], OFFSETS) is None
    assert merged([FiguresPart(format=0, starts=(), touch=TOUCH, grasp=GRASP)], OFFSETS) is None


def test_start_that_did_not_converge_adds_no_information() -> None:
    lost = start(2, won=False).model_copy(update={"information": None})
    both, alone = (
        merged([FiguresPart(starts=starts, touch=TOUCH, grasp=GRASP)], OFFSETS)
        for starts in ((start(1, won=True), lost), (start(1, won=True),))
    )
    assert both is not None
    assert alone is not None
    assert both.information == alone.information
    assert both.starts == 2


def test_digest_covers_all_but_the_cpu_time() -> None:
    found = merged([FiguresPart(starts=(start(1, won=True),), touch=TOUCH, grasp=GRASP)], OFFSETS)
    assert found is not None
    assert found.model_copy(update={"cpu_s": 9.0}).digest == found.digest
    assert found.model_copy(update={"starts": 2}).digest != found.digest


@pytest.mark.parametrize(("value", "kept"), [(1.2345678, 1.2346), (-98765432.0, -98765000.0), (0.0, 0.0)])
def test_five_digits_are_kept(value: float, kept: float) -> None:
    assert rounded(value) == kept


def test_each_variation_has_a_label_of_its_own() -> None:
    assert len({variation.label for variation in Variation}) == len(Variation)
