"""Starts of the fusion task: where the offset counts from, what is drawn, what is refused."""

from typing import Any

import numpy as np
import pytest
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.fusion_insertion.scene import FusionOffset, FusionStart, Target
from vitac.envs.tasks.settings import ResetOptionsError

ENV = FusionInsertionEnv()


def start(options: dict[str, Any], seed: int = 0, env: FusionInsertionEnv = ENV) -> FusionStart:
    return env.choose_start(options, np.random.default_rng(seed), env.settings)


def test_left_start_counts_from_the_hexagonal_hole() -> None:
    """As the 2025 code has it: [x, y + 22.625 - y_target, theta, z + 10.5]."""
    found = start({"start": (2.3, -4.1, -3.2, 8.8, 1)})
    assert found.target is Target.LEFT
    assert found.offset.as_array() == pytest.approx([2.3, -4.1 + 22.625 - 45.25, -3.2, 19.3])


def test_right_start_counts_from_the_rectangular_hole() -> None:
    found = start({"start": (-1.3, 2.1, 9.1, 7.9, 0)})
    assert found.target is Target.RIGHT
    assert found.offset.as_array() == pytest.approx([-1.3, 2.1 + 22.625, 9.1, 18.4])


def test_random_starts_fill_their_ranges_on_both_sides() -> None:
    found = [start({}, seed) for seed in range(300)]
    sides = [each.target is Target.LEFT for each in found]
    assert 0.4 < np.mean(sides) < 0.6
    world = np.array([each.offset.as_array() for each in found])
    world[:, 1] += [each.target.y_mm - 22.625 for each in found]
    world[:, 3] -= 10.5
    assert (world.min(axis=0) >= [-5, -5, -10, 3]).all()
    assert (world.max(axis=0) <= [5, 5, 10, 9]).all()
    assert (np.ptp(world, axis=0) > [9, 9, 18, 5]).all()


@pytest.mark.parametrize(
    "value",
    [
        (0, 0, 0, 5),
        (12.1, 0, 0, 5, 1),
        (0, 7.4, 0, 5, 1),
        (0, 0, 20.1, 5, 1),
        (0, 0, 0, -0.1, 1),
        (0, 0, 0, 22.0, 1),
        (0, 0, 0, 5, 2),
        (0, 0, 0, 5, 0.5),
        (0, 0, float("nan"), 5, 1),
        "left",
    ],
)
def test_unusable_start_is_refused_and_says_what_is_expected(value: Any) -> None:
    with pytest.raises(
        ResetOptionsError, match=r"'start' is .*expected \(x mm, y mm, theta deg, z mm, left 1 or right 0\)"
    ):
        start({"start": value})


def test_magnitude_is_the_norm_of_all_four() -> None:
    assert FusionOffset(x_mm=1.0, y_mm=-2.0, theta_deg=4.0, z_mm=2.0).magnitude() == 5.0


def test_directions_are_those_of_the_challenge() -> None:
    assert (Target.LEFT.direction, Target.RIGHT.direction) == (1.0, -1.0)


@pytest.mark.parametrize(("shape", "target"), [("hexagon", Target.LEFT), ("cuboid", Target.RIGHT)])
def test_one_shape_that_may_be_drawn_fixes_the_side_and_nothing_else(shape: str, target: Target) -> None:
    env = FusionInsertionEnv(shapes=[shape])
    found = [start({}, seed, env) for seed in range(8)]
    assert {each.target for each in found} == {target}
    assert [each.offset.x_mm for each in found] == [start({}, seed).offset.x_mm for seed in range(8)]
