"""Which episode is played: a given start, or a random one (challenge-facts 2.3, 7)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from ...geometry.bases import HEXAGON_HOLE_Y_MM, RIM_MM
from ...vision.pinhole import NOMINAL, RigShift
from ..insertion.offset import PegOffset
from ..options import choice, numbers, refusal
from .definition import TASK

ENV_ID = TASK.env_id
START = "start"
SHAPE = "shape"
# The task's own limits of the commanded offset; z is measured from the rim's height.
LARGEST_X_MM = 12.0
LARGEST_Y_MM = 30.0
LARGEST_THETA_DEG = 20.0
LARGEST_Z_MM = 15.0

# Height of the peg's lower end above the rim at z = 0.
START_GAP_MM = 1.0
_START_Y_MM = HEXAGON_HOLE_Y_MM / 2.0
# What the challenge takes off every height to get an offset [D20].
Z_TARGET_MM = 6.9
# A start may lie so far from the middle between the holes that its offset is still allowed.
_LARGEST_START_Y_MM = LARGEST_Y_MM - _START_Y_MM
_LARGEST_START_Z_MM = LARGEST_Z_MM + Z_TARGET_MM


class FusionShape(StrEnum):
    """Which peg is held."""

    HEXAGON = "hexagon"
    CUBOID = "cuboid"


class Target(StrEnum):
    """Which hole is the right one; it says which peg is held, too."""

    LEFT = "left"  # the hexagonal hole, at larger y
    RIGHT = "right"  # the rectangular hole, at the origin

    @classmethod
    def from_shape(cls, shape: FusionShape) -> "Target":
        """Return the hole that a peg belongs into."""
        return cls.LEFT if shape is FusionShape.HEXAGON else cls.RIGHT

    @property
    def shape(self) -> FusionShape:
        """Peg that belongs into the hole."""
        return FusionShape.HEXAGON if self is Target.LEFT else FusionShape.CUBOID

    @property
    def y_mm(self) -> float:
        """Centre of the hole in the world [mm]."""
        return HEXAGON_HOLE_Y_MM if self is Target.LEFT else 0.0

    @property
    def direction(self) -> float:
        """1 for left, -1 for right, as in the challenge's `gt_direction`."""
        return 1.0 if self is Target.LEFT else -1.0


@dataclass(frozen=True, kw_only=True)
class FusionOffset(PegOffset):
    """Pose of the peg (and the gripper) relative to the right hole.

    Attributes:
        z_mm: 9.5 where the peg's lower end is as high as the rim [mm].
    """

    z_mm: float


@dataclass(frozen=True, kw_only=True)
class FusionStart:
    """Start of an episode: where the peg stands, and which hole is the right one."""

    offset: FusionOffset
    target: Target


@dataclass(frozen=True, kw_only=True)
class RigVariation:
    """What differs between the rigs of two episodes.

    Attributes:
        shift: departure from the nominal pose.
        noise_seed: seed of the noise in its pictures.
    """

    shift: RigShift
    noise_seed: int


def choose_rig(
    random: np.random.Generator, *, turn_rad: float, offset_m: float, placed: RigShift = NOMINAL
) -> RigVariation:
    """Draw the rig of an episode: four numbers, also where it is not shifted, and the noise from a child generator.

    The child leaves the numbers that the markers get as they are.

    Args:
        random: the episode's generator.
        turn_rad: largest turn either way [rad].
        offset_m: largest offset either way along every axis [m].
        placed: where it stands before that.
    """
    turn, x, y, z = random.uniform(-1.0, 1.0, 4).tolist()
    (noise,) = random.spawn(1)
    return RigVariation(
        shift=RigShift(
            turn_rad=placed.turn_rad + turn * turn_rad,
            offset_m=tuple(at + part * offset_m for at, part in zip(placed.offset_m, (x, y, z), strict=True)),
        ),
        noise_seed=int(noise.integers(2**63)),
    )


def choose_start(
    options: dict[str, Any],
    random: np.random.Generator,
    *,
    shapes: Sequence[FusionShape] = tuple(FusionShape),
    xy_mm: float,
    theta_deg: float,
    z_mm: tuple[float, ...],
) -> FusionStart:
    """Return the start given by the options, or draw one: x, y, theta, z, and then the side.

    Args:
        options: may hold `start`: x and y from the middle between the holes [mm], theta [deg], z above the lowest
            start [mm], and 1 for left or 0 for right; and `shape`, which must then be that of the side, or else fixes
            the side of a drawn start.
        random: the episode's generator.
        shapes: that may be drawn.
        xy_mm: largest |x| and |y| of a drawn start.
        theta_deg: largest |theta| of a drawn start.
        z_mm: smallest and largest z of a drawn start.

    Raises:
        ResetOptionsError: the option is no usable start.
    """
    wanted = options.get(START)
    shape = None if options.get(SHAPE) is None else choice(ENV_ID, SHAPE, options[SHAPE], FusionShape)
    if wanted is not None:
        return _given(wanted, shape)
    x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
    z = random.uniform(z_mm[0], z_mm[1])
    side = Target.LEFT if random.random() < 0.5 else Target.RIGHT
    if shape is None and side.shape not in shapes:
        (shape,) = shapes
    target = side if shape is None else Target.from_shape(shape)
    return _placed((x * xy_mm, y * xy_mm, theta * theta_deg, z), target)


def _given(value: Any, shape: FusionShape | None) -> FusionStart:
    expected = (
        f"expected (x mm, y mm, theta deg, z mm, left 1 or right 0) with |x| of at most {LARGEST_X_MM:g}, |y| of at "
        f"most {_LARGEST_START_Y_MM:g}, |theta| of at most {LARGEST_THETA_DEG:g}, z of 0 to {_LARGEST_START_Z_MM:g}"
    )
    x, y, theta, z, left = numbers(ENV_ID, START, value, 5, expected)
    inside = abs(x) <= LARGEST_X_MM and abs(y) <= _LARGEST_START_Y_MM and abs(theta) <= LARGEST_THETA_DEG
    if not (inside and 0.0 <= z <= _LARGEST_START_Z_MM and left in (0.0, 1.0)):
        raise refusal(ENV_ID, START, value, expected)
    target = Target.LEFT if left else Target.RIGHT
    if shape is not None and target is not Target.from_shape(shape):
        raise refusal(ENV_ID, SHAPE, shape.value, f"expected {target.shape}, which is the peg of the start's side")
    return _placed((x, y, theta, z), target)


def _placed(start: Sequence[float], target: Target) -> FusionStart:
    x, y, theta, z = start
    offset = FusionOffset(x_mm=x, y_mm=y + _START_Y_MM - target.y_mm, theta_deg=theta, z_mm=z + RIM_MM - Z_TARGET_MM)
    return FusionStart(offset=offset, target=target)
