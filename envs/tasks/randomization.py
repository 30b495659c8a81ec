"""Settings that are drawn for every episode: published training ranges, or the quantities that a track file names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from .quantities import Draws, Quantity
from .settings import SettingsError

SettingsT = TypeVar("SettingsT")

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of settings, in the order of the draws; those of the physics as `physics.name`."""


class Randomization(StrEnum):
    """Which settings differ from episode to episode."""

    NONE = "none"
    """None do; every episode has those that the environment was made with."""
    CHALLENGE = "challenge"
    """Draw every quantity that has a published training range from it (challenge-facts 3)."""


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


def draw_quantities(draws: Draws, random: np.random.Generator) -> dict[str, float]:
    """Draw every quantity uniformly from its range; nothing is drawn where there are no ranges.

    Each has a generator of its own, seeded by its name and by one child of the episode's generator. So another quantity
    or range leaves the others as they are, and the numbers of starts and markers too.
    """
    if not draws:
        return {}
    seed = int(random.spawn(1)[0].integers(2**63))
    parts = {name: np.random.default_rng((seed, *name.encode())).random() for name in draws}
    return {name: float(f"{low + (high - low) * parts[name]:.6g}") for name, (low, high) in draws.items()}


def with_quantities(settings: SettingsT, quantities: Sequence[Quantity], drawn: Mapping[str, float]) -> SettingsT:
    """Return the settings of a task with these values of its quantities."""
    for quantity in quantities:
        if quantity.name in drawn:
            settings = quantity.apply(settings, drawn[quantity.name])
    return settings
