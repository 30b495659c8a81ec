"""Arguments of environments and options of resets: settings, fidelity, contact model, starts; what is wrong is said."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from difflib import get_close_matches
from enum import StrEnum
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from vitac.errors import VitacError

from ..fem.model.settings import ArenaContactSettings, ContactModel

if TYPE_CHECKING:
    from ..scene.grasped_scene import PhysicsSettings

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


SHAPE, RNG_SEED = "shape", "rng_seed"

ChoiceT = TypeVar("ChoiceT", bound=StrEnum)


class ResetOptionsError(VitacError):
    """An option of `reset` is unknown or out of range; the message names it and what it may be."""


def refuse_unknown(env_id: str, options: Mapping[str, Any], known: Collection[str]) -> None:
    """Refuse an option that a task does not have; `rng_seed` is every task's.

    Raises:
        ResetOptionsError: one is unknown.
    """
    names = [*known, RNG_SEED]
    for name in options:
        if name not in names:
            raise ResetOptionsError(f"{env_id} has no reset option '{name}'; {nearest(name, names)}")


def seeded_generator(env_id: str, rng_seed: Any) -> np.random.Generator:
    """Return the generator of an episode, from the integers in the options.

    Raises:
        ResetOptionsError: they are no seed.
    """
    parts = list(rng_seed) if isinstance(rng_seed, (tuple, list)) else [rng_seed]
    if not parts or not all(isinstance(part, int) and part >= 0 for part in parts):
        raise refusal(env_id, RNG_SEED, rng_seed, "expected non-negative integers (list seed, episode number)")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(parts)))


def choice(env_id: str, option: str, value: Any, kind: type[ChoiceT]) -> ChoiceT:
    """Return the member of a closed set that an option names.

    Raises:
        ResetOptionsError: it names none.
    """
    try:
        return kind(value)
    except ValueError:
        raise refusal(env_id, option, value, f"expected one of {', '.join(kind)}") from None


def chosen_shapes(env_id: str, kind: type[ChoiceT] | None, names: Sequence[str] | None) -> tuple[ChoiceT, ...]:
    """Return the shapes that `reset` draws from: those that are named, in the order of the set, or else all.

    Args:
        env_id: for the message.
        kind: all shapes of the task; None where it has none.
        names: as given to the environment.

    Raises:
        SettingsError: one is unknown, none is named, or the task has no shapes.
    """
    known = () if kind is None else tuple(kind)
    if names is None:
        return known
    unknown = [name for name in names if isinstance(names, str) or name not in set(known)]
    if unknown or not names:
        raise SettingsError(f"{env_id}: argument 'shapes' is {names!r}, expected some of {', '.join(known) or 'none'}.")
    return tuple(shape for shape in known if shape in names)


def choose_shape(
    env_id: str, options: Mapping[str, Any], shapes: Sequence[ChoiceT], random: np.random.Generator
) -> ChoiceT:
    """Return the shape that the options name, or else draw one of the shapes, all equally likely.

    Raises:
        ResetOptionsError: they name none of the set that the shapes are of.
    """
    given = options.get(SHAPE)
    if given is None:
        return shapes[int(random.integers(len(shapes)))]
    return choice(env_id, SHAPE, given, type(shapes[0]))


def numbers(env_id: str, option: str, value: Any, ranges: Sequence[tuple[float, float]], expected: str) -> list[float]:
    """Return the finite numbers of an option.

    Args:
        env_id: for the message.
        option: its name.
        value: as given.
        ranges: lowest and highest value of each number.
        expected: what it must be, for the message.

    Raises:
        ResetOptionsError: it is not as many finite numbers within their ranges.
    """
    try:
        read = [float(number) for number in value]
    except (TypeError, ValueError):
        read = []
    is_usable = len(read) == len(ranges) and all(
        isfinite(number) and low <= number <= high for number, (low, high) in zip(read, ranges, strict=True)
    )
    if not is_usable:
        raise refusal(env_id, option, value, expected)
    return read


def either_way(*largest: float) -> tuple[tuple[float, float], ...]:
    """Return the ranges of numbers that may be as large as these, either way."""
    return tuple((-each, each) for each in largest)


def refusal(env_id: str, option: str, value: Any, expected: str) -> ResetOptionsError:
    """Return the error for an option with an unusable value."""
    return ResetOptionsError(f"{env_id}: option '{option}' is {value!r}, {expected}.")


SettingsT = TypeVar("SettingsT")

FIDELITY = "fidelity"
# Of the gel that goes with arena-2; silicone has 0.45 to 0.49.
SILICONE_POISSON_RATIO = 0.48
_STEP_TOLERANCE_M, _RESIDUAL_TOLERANCE_N = 1e-5, 1e-2


class Fidelity(StrEnum):
    """Named trades of exactness for speed."""

    FULL = "full"
    """As episodes are ranked."""
    TRAINING = "training"
    """The challenge's gel in fewer elements, solved to a hundredth of a newton; never ranked (docs/training.md)."""


def find_fidelity(name: str, *, has_own_gel: bool) -> Fidelity:
    """Return the fidelity that an argument names.

    Args:
        name: as given.
        has_own_gel: whether the environment was given a gel, a sensor or a folder of meshes.

    Raises:
        SettingsError: it names none, or one that has a gel of its own beside a given one.
    """
    if name not in set(Fidelity):
        raise SettingsError(f"Argument 'fidelity' is {name!r}, expected one of {', '.join(Fidelity)}.")
    if has_own_gel and name != Fidelity.FULL:
        raise SettingsError(
            f"Argument 'fidelity' is '{name}', which has a gel of its own; leave out gel, sensor and assets_dir."
        )
    return Fidelity(name)


def with_fidelity(settings: SettingsT, fidelity: Fidelity) -> SettingsT:
    """Return the settings of a task with the solver of a fidelity.

    Raises:
        SettingsError: the settings were given a solver that is not the default one.
    """
    if fidelity is Fidelity.FULL:
        return settings
    physics: Any = settings.physics  # type: ignore[attr-defined]
    standard: Any = type(settings)().physics.solver  # type: ignore[attr-defined]
    if physics.solver != standard:
        raise SettingsError(f"Argument 'fidelity' is '{fidelity}', which has a solver of its own; leave out yours.")
    solver = replace(standard, step_tolerance_m=_STEP_TOLERANCE_M, residual_tolerance_n=_RESIDUAL_TOLERANCE_N)
    return replace(settings, physics=replace(physics, solver=solver))  # type: ignore[type-var]


def with_contact_model(settings: SettingsT, name: str | None, *, has_own_gel: bool = False) -> SettingsT:
    """Return the settings of a task with the contact model of this name; the same where they have it or none is named.

    Args:
        settings: of a task.
        name: "challenge-2025" or "arena-2".
        has_own_gel: whether the gels are others than the model's own, whose material goes with it.

    Raises:
        SettingsError: there is no such model, or the settings have been given another one.
    """
    if name is None:
        return settings
    if name not in set(ContactModel):
        raise SettingsError(f"Argument 'contact_model' is {name!r}, expected one of {', '.join(ContactModel)}.")
    physics: Any = settings.physics  # type: ignore[attr-defined]
    if physics.contact.model == name:
        return settings
    if name != ContactModel.ARENA_2:
        given = physics.contact.model
        raise SettingsError(
            f"Argument 'contact_model' is {name!r}, but the task's physics, or those given, have {given}; leave it out."
        )
    poisson_ratio = physics.poisson_ratio if has_own_gel else SILICONE_POISSON_RATIO
    physics = replace(physics, contact=ArenaContactSettings(), poisson_ratio=poisson_ratio)
    return replace(settings, physics=physics)  # type: ignore[type-var]


def arena_physics() -> "PhysicsSettings":
    """Return the contact model arena-2 with its gel; the rest as in the tasks of 2025."""
    from ..scene.grasped_scene import PhysicsSettings

    return PhysicsSettings(contact=ArenaContactSettings(), poisson_ratio=SILICONE_POISSON_RATIO)
