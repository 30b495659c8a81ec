"""Which episode is played: the key and where it stands in its lock, and how far off the sensors grip it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...geometry.keys_and_locks import KeyShape
from ..options import choice, drawn_shape, numbers, refusal
from .definition import TASK

ENV_ID = TASK.env_id
SHAPE, OFFSET, JITTER = "shape", "offset_mm", "sensor_jitter_mm"
# A start at which the key's tip is clear of the end wall and its shaft and teeth of floor, ceiling and walls.
X_RANGE_MM = (-1.4, 40.0)
LARGEST_Y_MM = 0.8
LARGEST_Z_MM = 0.8
LARGEST_JITTER_MM = 4.0


@dataclass(frozen=True, kw_only=True)
class KeyOffset:
    """Where the key stands at the start, relative to 6.5 mm inside its lock.

    Attributes:
        x_mm: outwards [mm].
        y_mm: sideways [mm].
        z_mm: upwards [mm].
    """

    x_mm: float
    y_mm: float
    z_mm: float


@dataclass(frozen=True, kw_only=True)
class SensorJitter:
    """Displacement of both sensors from their nominal place on the key.

    Attributes:
        x_mm: outwards [mm].
        z_mm: upwards [mm].
    """

    x_mm: float
    z_mm: float


@dataclass(frozen=True, kw_only=True)
class LockStart:
    """Start of an episode."""

    shape: KeyShape
    offset: KeyOffset
    jitter: SensorJitter


def choose_start(
    options: dict[str, Any],
    random: np.random.Generator,
    *,
    shapes: Sequence[KeyShape] = tuple(KeyShape),
    x_mm: float,
    jitter_mm: float,
) -> LockStart:
    """Return the start given by the options; what they leave open is drawn: key, x, then size and sign of each jitter.

    Args:
        options: may hold `shape`, `offset_mm` and `sensor_jitter_mm`.
        random: the episode's generator.
        shapes: that may be drawn.
        x_mm: a drawn offset has x from 0 to this, y = z = 0.
        jitter_mm: largest drawn jitter either way.

    Raises:
        ResetOptionsError: an option is not a known key or not a usable offset or jitter.
    """
    given = options.get(SHAPE)
    shape = drawn_shape(shapes, random) if given is None else choice(ENV_ID, SHAPE, given, KeyShape)
    wanted = options.get(OFFSET)
    offset = KeyOffset(x_mm=x_mm * random.random(), y_mm=0.0, z_mm=0.0) if wanted is None else _offset(wanted)
    off = options.get(JITTER)
    jitter = _random_jitter(random, jitter_mm) if off is None else _jitter(off)
    return LockStart(shape=shape, offset=offset, jitter=jitter)


def _random_jitter(random: np.random.Generator, jitter_mm: float) -> SensorJitter:
    x_mm = _random_sided(random, jitter_mm)
    return SensorJitter(x_mm=x_mm, z_mm=_random_sided(random, jitter_mm))


def _random_sided(random: np.random.Generator, largest: float) -> float:
    """Return a size from 0 to the largest, then a sign."""
    size = largest * random.random()
    return size if random.integers(2) else -size


def _offset(value: Any) -> KeyOffset:
    low, high = X_RANGE_MM
    expected = (
        f"expected (x, y, z) in mm with {low:g} <= x <= {high:g}, |y| <= {LARGEST_Y_MM:g}, |z| <= {LARGEST_Z_MM:g}"
    )
    x_mm, y_mm, z_mm = numbers(ENV_ID, OFFSET, value, 3, expected)
    if not (low <= x_mm <= high and abs(y_mm) <= LARGEST_Y_MM and abs(z_mm) <= LARGEST_Z_MM):
        raise refusal(ENV_ID, OFFSET, value, expected)
    return KeyOffset(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)


def _jitter(value: Any) -> SensorJitter:
    expected = f"expected (x, z) in mm within {LARGEST_JITTER_MM:g} either way"
    x_mm, z_mm = numbers(ENV_ID, JITTER, value, 2, expected)
    if max(abs(x_mm), abs(z_mm)) > LARGEST_JITTER_MM:
        raise refusal(ENV_ID, JITTER, value, expected)
    return SensorJitter(x_mm=x_mm, z_mm=z_mm)
