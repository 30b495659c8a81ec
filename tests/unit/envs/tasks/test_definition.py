import numpy as np
import pytest
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import (
    ActionComponent,
    EndReason,
    Flags,
    TaskDefinition,
    append_tables,
    surface_moved_too_far,
)

HEIGHT: Observable[float] = Observable(
    name="height", shape=(1,), unit="mm", meaning="Above the table.", read=lambda scene, _: np.array([scene])
)
TRUTH: Observable[float] = Observable(
    name="truth",
    shape=(2, 3),
    unit="m",
    meaning="Where it is.",
    read=lambda scene, _: np.full((2, 3), scene),
    privileged=True,
)
TASK = TaskDefinition(
    env_id="Test/Task-v1",
    environment="nowhere:Env",
    actions=(ActionComponent(name="lift", scale=2.0, unit="mm", meaning="Upwards."),),
    observables=(TRUTH, HEIGHT),
)


def test_a_policy_sees_nothing_privileged() -> None:
    assert TASK.public_observables == (HEIGHT,)


def test_tables_of_the_docstring_are_the_lists() -> None:
    docstring = append_tables(
        """Lift it.

        More.
        """,
        TASK,
    )
    lines = docstring.splitlines()
    assert lines[:4] == ["Lift it.", "", "More.", ""]
    assert "| 0 | lift | 2 mm | Upwards. |" in lines
    assert "| truth | (2, 3) | float32 | m | Where it is. **Only with `privileged=True`.** |" in lines
    assert "| height | (1,) | float32 | mm | Above the table. |" in lines


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
