"""Sensitivity and resolution of a sensor under small contacts; linear, so they take no episodes."""

from collections.abc import Iterable
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .figures import Row, SensitivityMap, TouchFigures, rounded

if TYPE_CHECKING:
    from vitac.envs.tactile.design import SensorDesign
    from vitac.envs.tactile.response import Response

FloatArray = NDArray[np.float64]

# Places of the map.
_SPACING_MM = 2.0
_HALF_X_MM, _HALF_Y_MM = 12.0, 10.0
# Standard deviation of the pressure around the middle of a pin or an edge.
_SPREAD_MM = 1.0
# A place senses where this part of a pin's pressure falls on sensing faces.
_LEAST_SHARE = 0.5
# Two pictures are distinguished with 95 % certainty where their markers differ by 2 x 1.645 standard deviations.
_SEPARATION = 3.29
_NOISE_PX = 0.5
_STEP_MM = 0.25


def touch_figures(design: "SensorDesign", *, youngs_modulus_pa: float, poisson_ratio: float) -> TouchFigures:
    """Return how the markers respond to a pin and to an edge that press with 1 N on the undeformed gel.

    Args:
        design: of the sensor.
        youngs_modulus_pa: of the gel [Pa].
        poisson_ratio: of the gel.
    """
    from vitac.envs.tactile.response import compute_response

    response = compute_response(design, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=poisson_ratio)
    x_mm, y_mm = _line(_HALF_X_MM), _line(_HALF_Y_MM)
    places = np.array([(x, y) for y in y_mm for x in x_mm])
    senses = _senses(response, places)
    normal, shear = np.full(len(places), np.nan), np.full(len(places), np.nan)
    normal[senses], shear[senses] = _sensitivity(response, places[senses])
    shape = len(y_mm), len(x_mm)
    return TouchFigures(
        sensitivity=SensitivityMap(
            x_mm=tuple(x_mm),
            y_mm=tuple(y_mm),
            normal_px_n=tuple(map(_row, normal.reshape(shape).tolist())),
            shear_px_n=tuple(map(_row, shear.reshape(shape).tolist())),
        ),
        normal_px_n=_median_at_places(normal[senses]),
        shear_px_n=_median_at_places(shear[senses]),
        pin_mm=_median_at_places(_pin_shifts_mm(response, places[senses])),
        edge_mm=(_median(_edge_shifts_mm(response, x_mm, 0)), _median(_edge_shifts_mm(response, y_mm, 1))),
    )


def mesh_error(
    design: "SensorDesign", finer: "SensorDesign", *, youngs_modulus_pa: float, poisson_ratio: float
) -> float | None:
    """Return how far the markers' motion under pins is from that on a finer mesh of the same gel (RMS, of its own).

    None where no place senses. Pins press with 1 N along the base's normal at the places of the map.

    Args:
        design: of the sensor.
        finer: the same sensor with more nodes.
        youngs_modulus_pa: of the gel [Pa]; the answer is the same for all.
        poisson_ratio: of the gel.
    """
    from vitac.envs.tactile.response import compute_response

    own, reference = (
        compute_response(each, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=poisson_ratio)
        for each in (design, finer)
    )
    places = np.array([(x, y) for y in _line(_HALF_Y_MM) for x in _line(_HALF_X_MM)])
    places = places[_senses(own, places) & _senses(reference, places)]
    if not len(places):
        return None
    moved, expected = (response.motion_px_n(_pin(response, places))[:, 2] for response in (own, reference))
    return rounded(float(np.sqrt(((moved - expected) ** 2).sum() / (expected**2).sum())))


def _line(half_mm: float) -> list[float]:
    return [float(value) for value in np.arange(-half_mm, half_mm + 0.5 * _SPACING_MM, _SPACING_MM)]


def _row(values: list[float]) -> Row:
    return tuple(None if np.isnan(value) else rounded(value) for value in values)


def _median(values: Iterable[float]) -> float:
    return rounded(median(float(value) for value in values))


def _median_at_places(values: FloatArray) -> float | None:
    """Return the median; None where no place senses, as on ridges with narrow tops."""
    return _median(values) if values.size else None


def _pin(response: "Response", places: FloatArray) -> FloatArray:
    """Return the pressure of pins at places, shape [q, p]."""
    apart = response.points_mm[:, None, :] - places[None]
    return np.asarray(np.exp(-(apart * apart).sum(axis=2) / (2.0 * _SPREAD_MM * _SPREAD_MM)))


def _edge(response: "Response", at_mm: FloatArray, axis: int) -> FloatArray:
    """Return the pressure of straight edges across an axis, as long as the gel, shape [q, p]."""
    apart = response.points_mm[:, axis, None] - at_mm
    return np.asarray(np.exp(-apart * apart / (2.0 * _SPREAD_MM * _SPREAD_MM)))


def _senses(response: "Response", places: FloatArray) -> NDArray[np.bool_]:
    whole = 2.0 * np.pi * _SPREAD_MM * _SPREAD_MM
    share = (_pin(response, places) * response.areas_mm2[:, None]).sum(axis=0) / whole
    return np.asarray(share >= _LEAST_SHARE)


def _sensitivity(response: "Response", places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the motion of all markers together, the root of the sum of squares [px/N], normal and along the base."""
    squared = (response.motion_px_n(_pin(response, places)) ** 2).sum(axis=0)
    return np.sqrt(squared[2]), np.sqrt(0.5 * (squared[0] + squared[1]))


def _pin_shifts_mm(response: "Response", places: FloatArray) -> FloatArray:
    """Return the smallest shift of a pin that can be detected, in the direction in which this is hardest."""
    slopes = []
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = _STEP_MM
        ahead, behind = (response.motion_px_n(_pin(response, places + way * step))[:, 2] for way in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * _STEP_MM))
    along_x, along_y = slopes
    xx, xy, yy = ((a * b).sum(axis=0) for a, b in ((along_x, along_x), (along_x, along_y), (along_y, along_y)))
    weakest = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    return _shifts_mm(weakest)


def _edge_shifts_mm(response: "Response", at_mm: list[float], axis: int) -> FloatArray:
    """Return the smallest shift of an edge across itself that can be detected."""
    # The outermost edges would leave the gel.
    inner = np.array(at_mm[1:-1])
    ahead, behind = (response.motion_px_n(_edge(response, inner + way * _STEP_MM, axis))[:, 2] for way in (1.0, -1.0))
    slope = (ahead - behind) / (2.0 * _STEP_MM)
    return _shifts_mm((slope * slope).sum(axis=0))


def _shifts_mm(squared_slopes: FloatArray) -> FloatArray:
    return np.asarray(_SEPARATION * _NOISE_PX / np.sqrt(np.maximum(squared_slopes, 1e-12)))
