"""Task settings given as keyword arguments of an environment: unknown names and wrong values are refused by name."""

from dataclasses import fields
from difflib import get_close_matches
from typing import Any, TypeVar

from ..errors import VitacError

Settings = TypeVar("Settings")


class SettingsError(VitacError):
    """A task setting is unknown or out of range; the message names it and what it may be."""


class UnknownSetting(SettingsError):
    """A setting is not one of the task's; the message names the nearest one.

    Attributes:
        name: of the setting.
        hint: which one may be meant.
    """

    def __init__(self, name: str, hint: str) -> None:
        self.name, self.hint = name, hint
        super().__init__(f"Unknown setting '{name}'; {hint}")


def read_task_settings(kind: type[Settings], overrides: dict[str, Any]) -> Settings:
    """Return the settings with some values replaced.

    Raises:
        SettingsError: a name is not a setting of this task, or its value has another type than the default.
    """
    defaults = kind()
    known = {field.name: getattr(defaults, field.name) for field in fields(defaults)}  # type: ignore[arg-type]
    for name, value in overrides.items():
        if name not in known:
            raise UnknownSetting(name, nearest(name, known))
        _check_type(name, value, known[name])
    return kind(**overrides)


def nearest(name: str, known: "dict[str, Any] | list[str]") -> str:
    """Return a hint with the most similar known name, or all of them."""
    close = get_close_matches(name, list(known), n=1)
    return f"did you mean '{close[0]}'?" if close else f"expected one of {', '.join(sorted(known))}."


def require(condition: bool, name: str, value: object, expected: str) -> None:
    """Refuse a setting that breaks a condition."""
    if not condition:
        raise SettingsError(f"Setting '{name}' is {value!r}, expected {expected}.")


def _check_type(name: str, value: Any, default: Any) -> None:
    number = isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool)
    if not number and type(value) is not type(default):
        kind = type(default).__name__
        raise SettingsError(f"Setting '{name}' is {value!r}, expected a value of type {kind} such as {default!r}.")
