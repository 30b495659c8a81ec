"""How a tactile sensor's camera is mounted and distorts, and its print is stretched, from the markers of a free gel."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..twin.gel_view import marker_grid, print_off, see_through_lens
from ..twin.hidden import HiddenSensor
from ..twin.structure import Print

Positions = NDArray[np.float64]

_NAMES: Final = ("shift_u_px", "shift_v_px", "turn_deg", "distortion", "print_stretch")
_STEPS: Final = np.array((0.1, 0.1, 0.05, 0.002, 0.002))
_NEAR_PX: Final = 15.0
_FEWEST: Final = 20
_ITERATIONS: Final = 6


class TooFewMarkers(VitacError):
    """A gel at rest shows too few markers to say how its camera is mounted; clean or replace it."""


class FittedCamera(NamedTuple):
    """A camera with the standard deviations of its numbers.

    Attributes:
        sensor: the camera.
        print: of the markers before it.
        deviations: by the names of the numbers.
        scatter_px: root mean square of what is left of a marker's place.
    """

    sensor: HiddenSensor
    print: Print
    deviations: dict[str, float]
    scatter_px: float

    @property
    def values(self) -> dict[str, float]:
        """The numbers by their names."""
        sensor = self.sensor
        return dict(
            zip(_NAMES, (*sensor.shift_px, sensor.turn_deg, sensor.distortion, self.print.stretch), strict=True)
        )


def fit_camera(markers_px: Positions) -> FittedCamera:
    """Return the camera and the print that put a grid where the markers are, shape [n, 2] [pixel].

    A print that is shifted or turned as a whole looks like a camera that is.

    Raises:
        TooFewMarkers: fewer than 20 are near the grid.
    """
    numbers = np.zeros(len(_NAMES))
    for _ in range(_ITERATIONS):
        seen = _see(numbers)
        distances = np.linalg.norm(seen[:, None] - markers_px[None], axis=2)
        nearest, is_near = distances.argmin(axis=1), distances.min(axis=1) < _NEAR_PX
        if is_near.sum() < _FEWEST:
            raise TooFewMarkers(
                f"Expected {_FEWEST} markers on the grid of a gel at rest, got {is_near.sum()}. Clean it."
            )
        left = (markers_px[nearest] - seen)[is_near].ravel()
        moved = [(_see(numbers + move) - seen)[is_near].ravel() for move in np.diag(_STEPS)]
        jacobian = np.array(moved).T / _STEPS
        numbers = numbers + np.linalg.lstsq(jacobian, left, rcond=None)[0]
    scatter_px = float(np.sqrt(np.mean(left**2)))
    deviations = scatter_px * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    return FittedCamera(*_split(numbers), dict(zip(_NAMES, deviations.tolist(), strict=True)), scatter_px)


def undo_lens(sensor: HiddenSensor, seen_px: Positions) -> Positions:
    """Return where an ideal camera would see what this one sees, shape [n, 2] [pixel]."""
    places = seen_px
    for _ in range(_ITERATIONS):
        places = places + seen_px - see_through_lens(sensor, places)
    return places


def stretched_print(stretch: float) -> Print:
    """Return a print that nothing else is wrong with: what shifts or turns it as a whole looks like the camera."""
    return Print(shift_px=(0.0, 0.0), turn_deg=0.0, stretch=stretch, scatter_px=0.0)


def _split(numbers: NDArray[np.float64]) -> tuple[HiddenSensor, Print]:
    u, v, turn_deg, distortion, stretch = numbers.tolist()
    return HiddenSensor(shift_px=(u, v), turn_deg=turn_deg, distortion=distortion), stretched_print(stretch)


def _see(numbers: NDArray[np.float64]) -> Positions:
    sensor, printed = _split(numbers)
    return see_through_lens(sensor, print_off(printed, marker_grid(), np.random.default_rng(0)))
