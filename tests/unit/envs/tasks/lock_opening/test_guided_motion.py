import numpy as np
import pytest
from vitac.envs.tasks.lock_opening.guided_motion import out_and_up
from vitac.envs.tasks.lock_opening.perspective import PERSPECTIVE
from vitac.envs.tasks.lock_opening.task import CEILING_Z_M, SUCCESS_Z_RANGE_M


def info(x_mm: float, z_mm: float) -> dict[str, np.ndarray]:
    """Both teeth this far inside their slots (towards +x) and above the ceiling."""
    slot_m = np.array([[0.02, -0.003, 0.03], [0.02, 0.003, 0.03], [0.024, -0.003, 0.03], [0.024, 0.003, 0.03]])
    tooth_m = slot_m + np.array([1e-3 * x_mm, 0.0, 0.0])
    tooth_m[:, 2] = CEILING_Z_M + 1e-3 * z_mm
    return {"key1_pts_m": tooth_m, "key2_pts_m": tooth_m - [0.016, 0.0, 0.0], "lock1_pts_m": slot_m}


def test_key_deep_in_the_lock_is_pulled_out_as_fast_as_allowed() -> None:
    action = out_and_up({}, info(-12.0, -0.1))
    assert action[0] == pytest.approx(-1.0)
    assert -1.0 < action[1] < 0.0


def test_key_below_its_slot_is_only_lifted() -> None:
    action = out_and_up({}, info(0.0, -0.1))
    assert action == pytest.approx([0.0, -1.0], abs=1e-6)


def test_lift_ends_half_a_millimetre_above_where_the_lock_opens() -> None:
    opening_mm = 1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M)
    assert out_and_up({}, info(0.0, opening_mm + 0.5)) == pytest.approx([0.0, 0.0], abs=1e-5)
    assert out_and_up({}, info(0.0, opening_mm + 0.25))[1] == pytest.approx(-0.25, abs=1e-5)


def test_place_of_the_rear_tooth_is_told_from_its_slot() -> None:
    assert PERSPECTIVE.position(info(-1.25, 0.5)) == "rear tooth from its slot x −1.25 mm, z +0.50 mm"


def test_heights_are_those_of_both_teeth_above_the_ceiling() -> None:
    progress = PERSPECTIVE.progress
    assert progress.heights_mm(info(0.0, 2.0)) == pytest.approx([2.0] * 8)
    assert progress.goal_mm == pytest.approx(1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M))
    assert not progress.goal_is_below
