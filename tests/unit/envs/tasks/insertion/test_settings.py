from collections.abc import Callable

import pytest
from vitac.envs.tasks.fusion_insertion.settings import FusionInsertionSettings
from vitac.envs.tasks.insertion.settings import InsertionSettings
from vitac.envs.tasks.peg_insertion.settings import PegInsertionSettings
from vitac.envs.tasks.settings import SettingsError

Make = Callable[..., InsertionSettings]
BOTH = pytest.mark.parametrize("make", [PegInsertionSettings, FusionInsertionSettings])


@BOTH
@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("max_steps", 0, "at least 1"),
        ("indentation_mm", 0.0, "0 to 2 mm, half the gel"),
        ("indentation_mm", 2.1, "0 to 2 mm, half the gel"),
        ("gripper_x_mm", -7.1, "-7 to 7 mm"),
        ("gripper_z_mm", 0.1, "-17 to 0 mm"),
        ("gripper_z_mm", -17.1, "-17 to 0 mm"),
        ("peg_friction", -0.1, "0 to 1000"),
        ("peg_friction", float("nan"), "0 to 1000"),
    ],
)
def test_what_no_insertion_can_be_played_with_is_refused_by_name(
    make: Make, name: str, value: float, expected: str
) -> None:
    with pytest.raises(SettingsError, match=rf"^Setting '{name}' is {value!r}, expected {expected}\.$"):
        make(**{name: value})


@BOTH
@pytest.mark.parametrize(
    "changes",
    [{"max_steps": 1}, {"indentation_mm": 2.0}, {"gripper_x_mm": 7.0}, {"gripper_z_mm": -17.0}, {"peg_friction": 1e3}],
)
def test_limits_are_allowed(make: Make, changes: dict[str, float]) -> None:
    (name, value), *_ = changes.items()
    assert getattr(make(**changes), name) == value


@pytest.mark.parametrize(
    ("make", "words", "count"), [(PegInsertionSettings, "three", 3), (FusionInsertionSettings, "four", 4)]
)
def test_scale_has_a_number_for_every_action(make: Make, words: str, count: int) -> None:
    assert make(action_scale_mm_deg=(20.0,) * count).action_scale_mm_deg == (20.0,) * count
    for scale in [(1.0,) * (count - 1), (1.0,) * (count + 1), (1.0,) * (count - 1) + (20.1,), (float("inf"),) * count]:
        with pytest.raises(SettingsError, match=f"expected {words} numbers of 0 to 20"):
            make(action_scale_mm_deg=scale)
