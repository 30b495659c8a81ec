import numpy as np
import pytest
from vitac.envs.tasks.ending import Flags
from vitac.envs.tasks.insertion.offset import PegOffset
from vitac.envs.tasks.insertion.state import InsertionState, compute_flags

HOLE = PegOffset(x_mm=0.0, y_mm=0.0, theta_deg=0.0)


def state(*, env_steps: int = 3, diff_m: float = 0.0, z_mm: tuple[float, ...] = ()) -> InsertionState[PegOffset]:
    return InsertionState(
        env_steps=env_steps,
        offset=HOLE,
        surface_diff_m=np.array([0.0, diff_m]),
        peg_relative_z_mm=np.array(z_mm),
    )


@pytest.mark.parametrize(("z_mm", "deeper"), [((-0.4, -0.31), True), ((-0.4, -0.3), False), ((-0.4, 0.1), False)])
def test_peg_is_deep_where_all_its_corners_are(z_mm: tuple[float, ...], deeper: bool) -> None:
    assert state(z_mm=z_mm).is_deeper_than(0.3) is deeper


def test_goal_counts_where_no_other_flag_is_raised() -> None:
    assert compute_flags(state(), max_steps=8, left_range=False, reached=True) == Flags(is_success=True)
    assert compute_flags(state(), max_steps=8, left_range=False, reached=False) == Flags()


def test_every_other_flag_takes_the_goal_away() -> None:
    assert compute_flags(state(), max_steps=8, left_range=True, reached=True) == Flags(error_too_large=True)
    assert compute_flags(state(env_steps=8), max_steps=8, left_range=False, reached=True) == Flags(too_many_steps=True)
    moved = compute_flags(state(diff_m=1.6e-3), max_steps=8, left_range=False, reached=True)
    assert moved == Flags(tactile_movement_too_large=True)
