from collections.abc import Sequence
from math import cos, radians, sin

import pytest
from vitac.evaluator.estimator import Controller, append_motion, move_offset, rotate_to_gripper
from vitac.evaluator.regression import Coefficients, Regression

SCALE = (2.0, 2.0, 4.0)


def constant(*values: float, variance: float = 1.0) -> Regression:
    """A regression that always says so, whatever one feature and the last motion are."""
    return Regression(
        means=(0.0,) * 4,
        scales=(1.0,) * 4,
        weights=(values, *((0.0,) * 3 for _ in range(4))),
        variances=(variance,) * 3,
    )


def controller(*regressions: Regression) -> Controller:
    return Controller(Coefficients(mesh_hash="m", starts=1, regressions=regressions), SCALE)


def acted(regressions: Sequence[Regression], times: int) -> list[list[float]]:
    acting = controller(*regressions)
    return [acting.act([0.0]) for _ in range(times)]


def test_action_removes_the_estimate() -> None:
    assert acted([constant(1.0, -0.5, 2.0)], 1) == [[-0.5, 0.25, -0.5]]


def test_action_stays_within_its_range() -> None:
    assert acted([constant(9.0, -9.0, 90.0)], 1) == [[-1.0, 1.0, -1.0]]


def test_far_offset_is_removed_over_several_env_steps() -> None:
    blind_later = constant(0.0, 0.0, 0.0, variance=1e9)
    actions = acted([constant(5.0, 0.0, 0.0), blind_later], 4)
    assert [action[0] for action in actions] == pytest.approx([-1.0, -1.0, -0.5, 0.0], abs=1e-6)


def test_estimates_are_weighed_by_their_variances() -> None:
    first, second = constant(0.0, 0.0, 0.0, variance=0.95), constant(1.0, 0.0, 0.0, variance=1.0)
    assert acted([first, second], 2)[1][0] == pytest.approx(-0.25)


def test_last_regression_holds_for_all_later_env_steps() -> None:
    assert len(acted([constant(0.0, 0.0, 0.0), constant(1.0, 1.0, 1.0)], 8)) == 8


def test_last_motion_is_a_feature() -> None:
    assert append_motion([7.0], [2.0, -1.0, 4.0], SCALE) == [7.0, 1.0, -0.5, 1.0]


@pytest.mark.parametrize("theta_deg", [-15.0, 0.0, 8.0])
def test_frames_of_world_and_gripper_agree_on_motions(theta_deg: float) -> None:
    """An action moves x and y along the gripper's axes as they were before it, as the environment does."""
    x, y, motion = 2.0, -3.0, (0.7, -0.4, 3.0)
    angle = radians(theta_deg)
    moved = (
        x + cos(angle) * motion[0] - sin(angle) * motion[1],
        y + sin(angle) * motion[0] + cos(angle) * motion[1],
        theta_deg + motion[2],
    )
    followed = move_offset(rotate_to_gripper((x, y, theta_deg)), motion)
    assert followed == pytest.approx(rotate_to_gripper(moved))
