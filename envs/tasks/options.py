"""Options of `reset`: each is checked and refused by name. Used by the base and by every task's `variation`."""

from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from math import isfinite
from typing import Any, TypeVar

import numpy as np

from ..errors import VitacError
from .settings import SettingsError, nearest

RNG_SEED = "rng_seed"

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


def drawn_shape(shapes: Sequence[ChoiceT], random: np.random.Generator) -> ChoiceT:
    """Draw one of the shapes, all equally likely."""
    return shapes[int(random.integers(len(shapes)))]


def numbers(env_id: str, option: str, value: Any, count: int, expected: str) -> list[float]:
    """Return the finite numbers of an option.

    Args:
        env_id: for the message.
        option: its name.
        value: as given.
        count: how many numbers it must be.
        expected: what it must be, for the message.

    Raises:
        ResetOptionsError: it is not this number of finite numbers.
    """
    try:
        found = [float(number) for number in value]
    except (TypeError, ValueError):
        found = []
    if len(found) != count or not all(isfinite(number) for number in found):
        raise refusal(env_id, option, value, expected)
    return found


def refusal(env_id: str, option: str, value: Any, expected: str) -> ResetOptionsError:
    """Return the error for an option with an unusable value."""
    return ResetOptionsError(f"{env_id}: option '{option}' is {value!r}, {expected}.")
