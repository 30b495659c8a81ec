"""The figures of a sensor as they are stored, shown and compared, and how parts of them are put together."""

import hashlib
import math
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Final

from pydantic import Field, NonNegativeFloat, PositiveInt

from ..regression import solve
from ..strict_model import StrictModel

FORMAT: Final = 1
"""Number of the definitions; figures by others are not compared."""
ENV_STEPS: Final = 3
"""Pictures from which the information is taken: before each of the first three actions."""
_DIGITS = 5

Symmetric = tuple[float, float, float, float, float, float]
"""A symmetric matrix over x, y and theta by its numbers xx, xy, xt, yy, yt, tt."""
Row = tuple[float | None, ...]


class Variation(StrEnum):
    """What is changed to see how much the standard score depends on it; the estimator stays as it was calibrated."""

    NONE = "none"
    """Nothing: the score to compare with."""
    FRICTION_LOW = "friction_low"
    """All friction coefficients times 0.7."""
    FRICTION_HIGH = "friction_high"
    """All friction coefficients times 1.3."""
    SOFTER = "softer"
    """Young's modulus times 0.8."""
    STIFFER = "stiffer"
    """Young's modulus times 1.2."""
    NOISE = "noise"
    """Markers with a noise of 1 px."""
    LOSS = "loss"
    """Markers are lost with a probability of 5 %."""
    FINER = "finer"
    """The gel's mesh refined to 1.5 times its nodes."""
    FINEST = "finest"
    """The gel's mesh refined to twice its nodes."""

    @property
    def label(self) -> str:
        """What tables call it."""
        return _LABELS[self]


_LABELS: Final = {
    Variation.NONE: "as it is",
    Variation.FRICTION_LOW: "friction -30 %",
    Variation.FRICTION_HIGH: "friction +30 %",
    Variation.SOFTER: "Young's modulus -20 %",
    Variation.STIFFER: "Young's modulus +20 %",
    Variation.NOISE: "noise 1 px",
    Variation.LOSS: "5 % of the markers lost",
    Variation.FINER: "1.5 times the nodes",
    Variation.FINEST: "twice the nodes",
}


class FigureChoice(StrEnum):
    """Which figures are measured."""

    NONE = "none"
    """None."""
    QUICK = "quick"
    """Figures that take no episodes: sensitivity, resolution, grasp."""
    ALL = "all"
    """Also information and robustness, which take about three times as long as both runs of the estimator."""


class SensitivityMap(StrictModel):
    """Motion of all markers together for 1 N at places of the gel [px/N]: rows along y, columns along x, as drawn.

    A place that does not sense has None.
    """

    x_mm: tuple[float, ...]
    y_mm: tuple[float, ...]
    normal_px_n: tuple[Row, ...]
    shear_px_n: tuple[Row, ...]


class TouchFigures(StrictModel):
    """What the markers do under small forces: medians over the map, and the smallest shifts that can be distinguished.

    The medians are None where no place of the map senses.
    """

    sensitivity: SensitivityMap
    normal_px_n: float | None
    shear_px_n: float | None
    pin_mm: float | None
    edge_mm: tuple[float, float]


class GraspFigures(StrictModel):
    """How the gel holds a free peg: deepest indentation, normal force of one finger, smallest det F."""

    indentation_mm: float
    force_n: float
    smallest_det_f: float


class StartFigures(StrictModel):
    """What was measured at one start.

    `information` has the Fisher information of the first picture, of two, and of three; None where an IPC step did not
    converge. `cpu_s` is that of the episode that was played without a variation.
    """

    episode: PositiveInt
    information: tuple[Symmetric, ...] | None
    smallest_det_f: float
    successes: dict[Variation, bool]
    cpu_s: NonNegativeFloat


class FiguresPart(StrictModel):
    """The part of a sensor's figures that one shard measures.

    `problem` says why something of it could not be measured, and is None where all was.
    """

    format: int = FORMAT
    starts: tuple[StartFigures, ...]
    touch: TouchFigures | None = None
    grasp: GraspFigures | None = None
    problem: str | None = None


class Information(StrictModel):
    """What the markers say about the offset (x [mm], y [mm], theta [degree]), expected over the starts.

    `bits` are those of one, two and three pictures; `bounds` are the standard deviations that no estimate from three
    pictures falls below, `prior` those of the starts themselves.
    """

    bits: tuple[float, ...]
    bounds: tuple[float, float, float]
    prior: tuple[float, float, float]


class Robustness(StrictModel):
    """Success rate of the standard estimator under one variation."""

    variation: Variation
    episodes: PositiveInt
    successes: int = Field(ge=0)

    @property
    def success_rate(self) -> float:
        """Share of the episodes."""
        return self.successes / self.episodes


class SensorFigures(StrictModel):
    """All figures of a sensor.

    `starts` says at how many starts information, robustness and CPU time of an episode were measured; there are none
    of no starts.
    """

    format: int = FORMAT
    starts: int
    information: Information | None
    touch: TouchFigures
    grasp: GraspFigures
    robustness: tuple[Robustness, ...]
    cpu_s: float | None

    @property
    def digest(self) -> str:
        """SHA-256 [hex] of all but the CPU time, which differs from machine to machine."""
        return hashlib.sha256(self.model_dump_json(exclude={"cpu_s"}).encode()).hexdigest()


def rounded(value: float) -> float:
    """Return a number as figures are stored, with five digits: more would differ from machine to machine."""
    return float(f"{value:.{_DIGITS}g}")


def merged(parts: Iterable[FiguresPart], offsets: Sequence[Sequence[float]]) -> SensorFigures | None:
    """Return the figures of a sensor from its parts; None where a part that is needed is not there.

    Args:
        parts: of shards, in any order; of two with the same start the later one counts.
        offsets: of the starts in the list, whose distribution is the prior [mm, mm, deg].
    """
    held = [part for part in parts if part.format == FORMAT]
    touch = next((part.touch for part in held if part.touch is not None), None)
    grasp = next((part.grasp for part in held if part.grasp is not None), None)
    starts = sorted({start.episode: start for part in held for start in part.starts}.values(), key=_episode)
    if touch is None or grasp is None:
        return None
    least = min([grasp.smallest_det_f, *(start.smallest_det_f for start in starts)])
    return SensorFigures(
        starts=len(starts),
        information=expected_information([s.information for s in starts if s.information is not None], offsets),
        touch=touch,
        grasp=grasp.model_copy(update={"smallest_det_f": least}),
        robustness=tuple(_robustness(starts)),
        cpu_s=rounded(sum(start.cpu_s for start in starts) / len(starts)) if starts else None,
    )


def expected_information(
    matrices: Sequence[Sequence[Symmetric]], offsets: Sequence[Sequence[float]]
) -> Information | None:
    """Return what pictures say about the offset, with the covariance S of the starts as that of a normal prior.

    With the Fisher information F at a start, the posterior's covariance is (S^-1 + F)^-1, and the information
    1/2 log2 det(1 + S F) bits (K. Chaloner and I. Verdinelli, Bayesian experimental design: a review, Statistical
    Science 10 (1995) 273-304, section 4); both are averaged over the starts.

    Args:
        matrices: Fisher information of one, two and three pictures at every start.
        offsets: of the starts, whose distribution is the prior [mm, mm, deg].
    """
    if not matrices:
        return None
    prior = _covariance(offsets)
    precision = _inverse(prior)
    bits = []
    for pictures in range(ENV_STEPS):
        gains = [
            _determinant(_sum(precision, _matrix(start[pictures]))) / _determinant(precision) for start in matrices
        ]
        bits.append(sum(0.5 * math.log2(gain) for gain in gains) / len(gains))
    posteriors = [_inverse(_sum(precision, _matrix(start[-1]))) for start in matrices]
    x, y, theta = (math.sqrt(sum(of[k][k] for of in posteriors) / len(posteriors)) for k in range(3))
    prior_x, prior_y, prior_theta = (rounded(math.sqrt(prior[k][k])) for k in range(3))
    return Information(
        bits=tuple(map(rounded, bits)),
        bounds=(rounded(x), rounded(y), rounded(theta)),
        prior=(prior_x, prior_y, prior_theta),
    )


def _robustness(starts: Sequence[StartFigures]) -> Iterable[Robustness]:
    for variation in Variation:
        played = [start.successes[variation] for start in starts if variation in start.successes]
        if played:
            yield Robustness(variation=variation, episodes=len(played), successes=sum(played))


def _episode(start: StartFigures) -> int:
    return start.episode


def _matrix(numbers: Symmetric) -> list[list[float]]:
    xx, xy, xt, yy, yt, tt = numbers
    return [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]


def _sum(first: list[list[float]], second: list[list[float]]) -> list[list[float]]:
    return [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(first, second, strict=True)]


def _inverse(matrix: list[list[float]]) -> list[list[float]]:
    return solve(matrix, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def _determinant(matrix: list[list[float]]) -> float:
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _covariance(offsets: Sequence[Sequence[float]]) -> list[list[float]]:
    n = len(offsets)
    means = [sum(column) / n for column in zip(*offsets, strict=True)]
    return [[sum((row[i] - means[i]) * (row[j] - means[j]) for row in offsets) / n for j in range(3)] for i in range(3)]
