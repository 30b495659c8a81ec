"""The largest principal stretch, and what a grip reports of it."""

import numpy as np
import pytest
from small_scenes import Grip
from vectors import columns3
from vitac.envs.fem.elastic.elasticity import largest_stretch


@pytest.mark.parametrize("stretches", [(1.3, 0.9, 0.8), (1.0, 1.0, 1.0), (1.2, 1.2, 0.7), (1.5, 0.8, 0.8)])
def test_largest_stretch_is_the_largest_singular_value(stretches: tuple[float, float, float]) -> None:
    random = np.random.default_rng(3)
    for _ in range(20):
        first, second = (np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(2))
        F = first @ np.diag(stretches) @ second
        assert largest_stretch(columns3(F)) == pytest.approx(max(stretches), abs=2e-8)
        F = F + random.normal(size=(3, 3)) * 0.2
        assert largest_stretch(columns3(F)) == pytest.approx(np.linalg.svd(F)[1][0], abs=1e-8)


def test_a_gel_that_is_pressed_harder_is_stretched_more() -> None:
    grip = Grip(gap_m=3e-4)
    free, touching = grip.squeeze(0.0), [grip.squeeze(4e-4) for _ in range(3)]
    assert free.largest_stretch == free.high_stretch == pytest.approx(1.0, abs=1e-9)
    assert 1.0 < touching[0].largest_stretch < touching[1].largest_stretch < touching[2].largest_stretch
    assert all(1.0 < report.high_stretch < report.largest_stretch for report in touching)
