import numpy as np
import pytest
from vitac.envs.tasks.ending import EndReason, Flags, surface_moved_too_far


@pytest.mark.parametrize(
    ("flags", "failure"),
    [
        (Flags(), None),
        (Flags(is_success=True), None),
        (Flags(too_many_steps=True), EndReason.STEPS),
        (Flags(too_many_steps=True, error_too_large=True), EndReason.ERROR),
        (Flags(too_many_steps=True, error_too_large=True, tactile_movement_too_large=True), EndReason.TACTILE),
        (Flags(tactile_movement_too_large=True, is_success=True), EndReason.TACTILE),
    ],
)
def test_tactile_is_named_before_error_before_steps(flags: Flags, failure: EndReason | None) -> None:
    assert flags.failure is failure


@pytest.mark.parametrize(("left_mm", "right_mm", "too_far"), [(1.5, 1.5, False), (1.501, 0, True), (0, 1.6, True)])
def test_either_surface_may_move_one_and_a_half_millimetres(left_mm: float, right_mm: float, too_far: bool) -> None:
    assert surface_moved_too_far(np.array([left_mm, right_mm]) * 1e-3) is too_far
