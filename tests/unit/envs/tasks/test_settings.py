from dataclasses import dataclass
from typing import Any

import pytest
from vitac.envs.tasks.settings import SettingsError, nearest, read_task_settings, require


@dataclass(frozen=True, kw_only=True)
class Settings:
    max_steps: int = 8
    z_step_mm: float = 0.125
    scale: tuple[float, float] = (1.0, 2.0)


def test_overrides_replace_defaults() -> None:
    assert read_task_settings(Settings, {"max_steps": 3, "z_step_mm": 1}) == Settings(max_steps=3, z_step_mm=1)
    assert read_task_settings(Settings, {}) == Settings()


def test_unknown_setting_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"Unknown setting 'z_step_size_mm'; did you mean 'z_step_mm'\?"):
        read_task_settings(Settings, {"z_step_size_mm": 0.075})


@pytest.mark.parametrize(
    ("name", "value"), [("max_steps", 2.5), ("max_steps", True), ("z_step_mm", "1"), ("scale", 3.0)]
)
def test_value_of_another_type_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=f"'{name}' is .*expected a value of type"):
        read_task_settings(Settings, {name: value})


def test_hint_lists_all_names_where_none_is_near() -> None:
    assert nearest("qqqq", ["beta", "alpha"]) == "expected one of alpha, beta."


def test_require_names_setting_value_and_range() -> None:
    require(True, "a", 1, "anything")
    with pytest.raises(SettingsError, match="Setting 'a' is 1, expected 2 to 3"):
        require(False, "a", 1, "2 to 3")
