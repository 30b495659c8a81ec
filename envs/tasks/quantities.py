"""Quantities that differ from episode to episode: published training ranges, or those that a track file names.

Each task lists its own and those that all tasks have; a policy never sees what was drawn. Light to import.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np

from .settings import SettingsError, nearest, require

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
        apply: gives the settings of a task with this value; those with the setting of the same name by default.
    """

    name: str
    unit: str
    meaning: str
    range: tuple[float, float]
    nominal: float
    apply: Callable[[Any, float], Any] | None = None
    two_sided: bool = False

    @property
    def label(self) -> str:
        """Meaning and unit, as on the axis of a plot."""
        return self.meaning if self.unit == "1" else f"{self.meaning} [{self.unit}]"


def symmetric(
    *, name: str, unit: str, meaning: str, largest: float, apply: Callable[[Any, float], Any] | None = None
) -> Quantity:
    """Return a quantity that may differ from 0, its value in 2025, by as much to either side."""
    return Quantity(
        name=name, unit=unit, meaning=meaning, range=(-largest, largest), nominal=0.0, apply=apply, two_sided=True
    )


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
                "set contact_model: arena-2."
            )
        drawn = tuple(
            replace(pair, coefficient=value) if {pair.first, pair.second} == {first, second} else pair
            for pair in contact.pair_frictions
        )
        return replace(settings, physics=replace(settings.physics, contact=replace(contact, pair_frictions=drawn)))

    return apply


def branch(name: str) -> Callable[[Any, float], Any]:
    """Return what sets a field of the gels' viscous branch; without one its ratio is 0 and its time 1 s."""
    from ..fem.model.mesh import PronyBranch

    def apply(settings: Any, value: float) -> Any:
        present = (*settings.physics.viscosity, PronyBranch(modulus_ratio=0.0, relaxation_time_s=1.0))[0]
        viscosity = (replace(present, **{name: value}),)
        return replace(settings, physics=replace(settings.physics, viscosity=viscosity))

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


def check_quantities(settings: Any, quantities: Sequence[Quantity]) -> None:
    """Refuse settings outside of the ranges of the quantities with their names.

    Raises:
        SettingsError: one is.
    """
    for quantity in quantities:
        (low, high), value = quantity.range, getattr(settings, quantity.name)
        unit = {"1": "", "degree": " degrees"}.get(quantity.unit, f" {quantity.unit}")
        require(low <= value <= high, quantity.name, value, f"{low:g} to {high:g}{unit}")


def mount(side: str, name: str) -> Callable[[Any, float], Any]:
    """Return what sets a field of how the camera of the left or right sensor is mounted."""

    def apply(settings: Any, value: float) -> Any:
        from ..tactile.markers import MountedMarkerSettings

        present = settings.markers
        markers = MountedMarkerSettings(**{each.name: getattr(present, each.name) for each in fields(present)})
        changed = getattr(markers, side)._replace(**{name: value})
        return replace(settings, markers=replace(markers, **{side: changed}))

    return apply


CAMERA_MOUNT_QUANTITIES = tuple(
    symmetric(
        name=f"{side}_{name}",
        unit=unit,
        meaning=f"{meaning} of the {side} sensor",
        largest=largest,
        apply=mount(side, name),
    )
    for side in ("left", "right")
    for name, unit, meaning, largest in (
        ("shift_u_px", "px", "Shift along u of the picture", 20.0),
        ("shift_v_px", "px", "Shift along v of the picture", 20.0),
        ("turn_deg", "degree", "Turn of the picture", 10.0),
        ("distortion", "1", "Distortion at a corner of the picture", 0.2),
    )
)

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
        name="gel_poisson_ratio",
        unit="1",
        meaning="Poisson's ratio of both gels",
        range=(0.0, 0.49),
        nominal=0.48,
        apply=setting("physics.poisson_ratio"),
    ),
    Quantity(
        name="gel_viscous_ratio",
        unit="1",
        meaning="Shear modulus of both gels that relaxes, over the one that stays",
        range=(0.0, 2.0),
        nominal=0.0,
        apply=branch("modulus_ratio"),
    ),
    Quantity(
        name="gel_relaxation_s",
        unit="s",
        meaning="Relaxation time of both gels",
        range=(0.01, 100.0),
        nominal=1.0,
        apply=branch("relaxation_time_s"),
    ),
    Quantity(
        name="indentation_mm",
        unit="mm",
        meaning="Indentation of each gel",
        range=(0.3, 1.5),
        nominal=0.875,
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
    symmetric(
        name="drift_u_px_s",
        unit="px/s",
        meaning="Drift of both sensors' pictures along u",
        largest=20.0,
        apply=setting("markers.drift_u_px_s"),
    ),
    symmetric(
        name="drift_v_px_s",
        unit="px/s",
        meaning="Drift of both sensors' pictures along v",
        largest=20.0,
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
    *CAMERA_MOUNT_QUANTITIES,
)
"""Quantities of every task with two tactile sensors."""


SettingsT = TypeVar("SettingsT")

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of settings, in the order of the draws; those of the physics as `physics.name`."""


class Randomization(StrEnum):
    """Which settings differ from episode to episode."""

    NONE = "none"
    """None do; every episode has those that the environment was made with."""
    CHALLENGE = "challenge"
    """Draw every quantity that has a published training range from it."""


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
            apply = quantity.apply or setting(quantity.name)
            settings = apply(settings, drawn[quantity.name])
    return settings
