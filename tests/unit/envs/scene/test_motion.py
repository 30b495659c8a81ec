import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.scene.motion import MotionError, ipc_steps


@pytest.mark.parametrize(
    ("amount", "speed", "time_step_s", "expected"),
    [
        (0.975e-3, 5e-3, 0.1, 2),  # grasp of the peg
        (1.1e-3, 5e-3, 0.1, 2),
        (0.225e-3, 1e-3, 0.1, 2),  # descent before the first env step
        (1.375e-3, 2e-3, 0.2, 3),  # grasp of the key
        (2e-3, 5e-3, 0.1, 4),
        (2.83e-3, 5e-3, 0.1, 6),
        (0.06981317, 0.2, 0.1, 3),  # 4 degrees
        (0.125e-3, 5e-3, 0.1, 1),
        (2e-3, 2e-3, 0.2, 5),
        (0.0, 5e-3, 0.1, 1),
    ],
)
def test_counts_are_those_of_the_2025_code(amount: float, speed: float, time_step_s: float, expected: int) -> None:
    assert ipc_steps(amount, speed_per_s=speed, time_step_s=time_step_s) == expected


def test_ties_go_to_the_even_count() -> None:
    assert ipc_steps(2.5, speed_per_s=1.0, time_step_s=1.0) == 2
    assert ipc_steps(3.5, speed_per_s=1.0, time_step_s=1.0) == 4


@given(st.floats(-10, 10))
def test_sign_does_not_matter_and_one_is_the_least(amount: float) -> None:
    count = ipc_steps(amount, speed_per_s=1.0, time_step_s=0.1)
    assert count == ipc_steps(-amount, speed_per_s=1.0, time_step_s=0.1) >= 1


@pytest.mark.parametrize(("speed", "time_step_s"), [(0.0, 0.1), (1.0, 0.0), (-1.0, 0.1)])
def test_refuses_a_speed_or_time_step_that_is_not_positive(speed: float, time_step_s: float) -> None:
    with pytest.raises(MotionError, match="must be positive"):
        ipc_steps(1.0, speed_per_s=speed, time_step_s=time_step_s)
