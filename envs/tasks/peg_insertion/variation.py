"""Which episode is played: a given shape and offset, or a random start that really blocks the peg."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Any

import numpy as np

from ...deterministic_math import sine_cosine
from ...geometry.pegs import CHALLENGE_FORM, PLATE_OUTLINE_MM, PegForm, PegShape, hole_outline_mm, profile_mm
from ...geometry.solid import overlaps_plate
from ..insertion.offset import PegOffset
from ..options import choice, drawn_shape, numbers, refusal
from .definition import TASK

ENV_ID = TASK.env_id
SHAPE, OFFSET = "shape", "offset_mm_deg"
# The task's own limits of the commanded offset.
LARGEST_XY_MM = 12.0
LARGEST_THETA_DEG = 15.0


@dataclass(frozen=True, kw_only=True)
class PegStart:
    """Start of an episode."""

    shape: PegShape
    offset: PegOffset


def choose_start(
    options: dict[str, Any],
    random: np.random.Generator,
    *,
    shapes: Sequence[PegShape] = tuple(PegShape),
    form: PegForm = CHALLENGE_FORM,
    xy_mm: float,
    theta_deg: float,
) -> PegStart:
    """Return the start given by the options; what they leave open is drawn: first the shape, then a blocked offset.

    Args:
        options: may hold `shape` and `offset_mm_deg`.
        random: the episode's generator.
        shapes: that may be drawn.
        form: of peg and hole.
        xy_mm: largest |x| and |y| of a drawn offset.
        theta_deg: largest |theta| of a drawn offset.

    Raises:
        ResetOptionsError: an option is not a known shape or not a usable offset.
    """
    given = options.get(SHAPE)
    shape = drawn_shape(shapes, random) if given is None else choice(ENV_ID, SHAPE, given, PegShape)
    wanted = options.get(OFFSET)
    offset = (
        random_blocked_offset(shape, random, form=form, xy_mm=xy_mm, theta_deg=theta_deg)
        if wanted is None
        else _offset(wanted)
    )
    return PegStart(shape=shape, offset=offset)


def random_blocked_offset(
    shape: PegShape, random: np.random.Generator, *, form: PegForm = CHALLENGE_FORM, xy_mm: float, theta_deg: float
) -> PegOffset:
    """Return a uniform offset (drawn x, y, theta), drawn again until the peg cannot just fall into the hole.

    The 2025 code asks a collision library about the solids; prisms with one axis collide where their profiles do.
    """
    while True:
        x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
        offset = PegOffset(x_mm=x * xy_mm, y_mm=y * xy_mm, theta_deg=theta * theta_deg)
        if is_blocked(shape, offset, form):
            return offset


def accepts_start(shape: str, offset_mm_deg: tuple[float, float, float]) -> bool:
    """Return whether an episode may start there: the peg must not just fall into the hole."""
    x_mm, y_mm, theta_deg = offset_mm_deg
    return is_blocked(PegShape(shape), PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg))


def is_blocked(shape: PegShape, offset: PegOffset, form: PegForm = CHALLENGE_FORM) -> bool:
    """Return whether the peg's profile at this offset meets the plate's material."""
    sine, cosine = sine_cosine(radians(offset.theta_deg))
    x, y = profile_mm(shape, form).T
    placed = np.column_stack([cosine * x - sine * y + offset.x_mm, sine * x + cosine * y + offset.y_mm])
    return overlaps_plate(placed, plate=PLATE_OUTLINE_MM, hole=hole_outline_mm(shape, form))


def _offset(value: Any) -> PegOffset:
    expected = (
        f"expected (x mm, y mm, theta deg) within {LARGEST_XY_MM:g} mm and {LARGEST_THETA_DEG:g} degrees either way"
    )
    x_mm, y_mm, theta_deg = numbers(ENV_ID, OFFSET, value, 3, expected)
    if max(abs(x_mm), abs(y_mm)) > LARGEST_XY_MM or abs(theta_deg) > LARGEST_THETA_DEG:
        raise refusal(ENV_ID, OFFSET, value, expected)
    return PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)
