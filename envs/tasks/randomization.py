"""Settings that are drawn for every episode, for training; never in an evaluation."""

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from .settings import SettingsError

SettingsT = TypeVar("SettingsT")

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of settings, in the order of the draws; those of the physics as `physics.name`."""


class Randomization(StrEnum):
    """Which settings differ from episode to episode."""

    NONE = "none"
    """None do; every episode has those that the environment was made with."""
    CHALLENGE = "challenge"
    """Those that have a published training range are drawn from it (challenge-facts 3)."""


def find_randomization(value: str) -> Randomization:
    """Return the randomization that an argument names.

    Raises:
        SettingsError: it names none.
    """
    try:
        return Randomization(value)
    except ValueError:
        expected = ", ".join(Randomization)
        raise SettingsError(f"Argument 'randomization' is {value!r}, expected one of {expected}.") from None


def drawn_settings(settings: SettingsT, ranges: Ranges, random: np.random.Generator) -> SettingsT:
    """Return the settings with those that have a range drawn from it, uniformly, in the order of the ranges."""
    own: dict[str, Any] = {}
    physics: dict[str, Any] = {}
    for name, (low, high) in ranges.items():
        group, _, field = name.rpartition(".")
        (physics if group else own)[field] = float(random.uniform(low, high))
    if physics:
        own["physics"] = replace(settings.physics, **physics)  # type: ignore[attr-defined]
    return replace(settings, **own)  # type: ignore[type-var]
