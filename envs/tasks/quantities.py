"""Quantities that may differ from episode to episode, drawn from ranges that a track file states; light to import.

Each task lists its own and those that all tasks have. A policy never sees what was drawn.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from .settings import SettingsError, nearest

Draws = Mapping[str, tuple[float, float]]
"""Lowest and highest value of quantities by name; each is drawn uniformly."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of an episode.

    Attributes:
        name: in track files and in the info.
        unit: of the number.
        meaning: for tables and plots.
        range: smallest and largest value that can be drawn at all.
        nominal: value in the 2025 evaluation; success is plotted against the distance from it where both sides are
            equally hard.
        two_sided: whether both sides of the nominal value are equally hard.
        apply: gives the settings of a task with this value.
    """

    name: str
    unit: str
    meaning: str
    range: tuple[float, float]
    nominal: float
    apply: Callable[[Any, float], Any]
    two_sided: bool = False

    @property
    def label(self) -> str:
        """Meaning and unit, as on the axis of a plot."""
        return self.meaning if self.unit == "1" else f"{self.meaning} [{self.unit}]"


def setting(path: str, scale: float = 1.0) -> Callable[[Any, float], Any]:
    """Return what puts a value, times a scale, in the place of a setting such as `physics.youngs_modulus_pa`."""
    group, _, name = path.rpartition(".")

    def apply(settings: Any, value: float) -> Any:
        if not group:
            return replace(settings, **{name: value * scale})
        return replace(settings, **{group: replace(getattr(settings, group), **{name: value * scale})})

    return apply


def pair_friction(first: str, second: str) -> Callable[[Any, float], Any]:
    """Return what sets the friction coefficient of two materials, which only contact models by materials have."""

    def apply(settings: Any, value: float) -> Any:
        contact = settings.physics.contact
        if not hasattr(contact, "pair_frictions"):
            raise SettingsError(
                f"The friction of {first} on {second} cannot be drawn under the contact model {contact.model}; "
                "set contact_model: arena-1."
            )
        drawn = tuple(
            replace(pair, coefficient=value) if {pair.first, pair.second} == {first, second} else pair
            for pair in contact.pair_frictions
        )
        return replace(settings, physics=replace(settings.physics, contact=replace(contact, pair_frictions=drawn)))

    return apply


def check_draws(env_id: str, draws: Mapping[str, Sequence[float]], known: Sequence[Quantity]) -> Draws:
    """Return the ranges of quantities, checked.

    Raises:
        SettingsError: a quantity is unknown, or its range does not rise within what can be drawn.
    """
    quantities = {quantity.name: quantity for quantity in known}
    for name, limits in draws.items():
        if name not in quantities:
            raise SettingsError(f"{env_id} has no quantity '{name}' to draw; {nearest(name, list(quantities))}")
        low, high = quantities[name].range
        if len(limits) != 2 or not low <= limits[0] <= limits[1] <= high:
            unit = quantities[name].unit
            raise SettingsError(
                f"Draw '{name}' is {list(limits)}, expected two numbers from {low:g} to {high:g} {unit}, rising."
            )
    return {name: (float(draws[name][0]), float(draws[name][1])) for name in draws}


TOUCH_QUANTITIES = (
    Quantity(
        name="gel_modulus_kpa",
        unit="kPa",
        meaning="Young's modulus of both gels",
        range=(50.0, 2000.0),
        nominal=300.0,
        apply=setting("physics.youngs_modulus_pa", 1e3),
    ),
    Quantity(
        name="indentation_mm",
        unit="mm",
        meaning="Indentation of each gel",
        range=(0.3, 1.5),
        nominal=0.875,
        apply=setting("indentation_mm"),
    ),
    Quantity(
        name="gel_friction",
        unit="1",
        meaning="Friction coefficient of the gels on the part",
        range=(0.2, 3.0),
        nominal=1.0,
        apply=pair_friction("gel", "part"),
    ),
    Quantity(
        name="part_friction",
        unit="1",
        meaning="Friction coefficient of the parts on each other",
        range=(0.0, 1.0),
        nominal=0.3,
        apply=pair_friction("part", "part"),
    ),
    Quantity(
        name="marker_noise_px",
        unit="px",
        meaning="Noise of every marker",
        range=(0.0, 10.0),
        nominal=0.5,
        apply=setting("markers.noise_px"),
    ),
    Quantity(
        name="marker_loss",
        unit="1",
        meaning="Probability that a marker is lost",
        range=(0.0, 0.9),
        nominal=0.01,
        apply=setting("markers.loss_probability"),
    ),
    Quantity(
        name="drift_u_px_s",
        unit="px/s",
        meaning="Drift of both sensors' pictures along u",
        range=(-20.0, 20.0),
        nominal=0.0,
        two_sided=True,
        apply=setting("markers.drift_u_px_s"),
    ),
    Quantity(
        name="drift_v_px_s",
        unit="px/s",
        meaning="Drift of both sensors' pictures along v",
        range=(-20.0, 20.0),
        nominal=0.0,
        two_sided=True,
        apply=setting("markers.drift_v_px_s"),
    ),
    Quantity(
        name="touch_delay",
        unit="1",
        meaning="Part of an env step by which touch lags behind",
        range=(0.0, 1.0),
        nominal=0.0,
        apply=setting("markers.delay"),
    ),
)
"""Quantities of every task with two tactile sensors."""
