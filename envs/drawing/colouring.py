"""What the colour of a gel means: the quantity, its unit, and one scale for all moments of an episode."""

from dataclasses import dataclass
from enum import StrEnum
from math import ceil, floor, log10

import numpy as np
from numpy.typing import NDArray

from .playback import Moment, Playback
from .stress import cauchy_stress_pa, deformation_gradients, displacement_m, nodal_means, von_mises_pa

FloatArray = NDArray[np.float64]
_WITHIN = (0.01, 0.99)
_ROUNDING = 1e-6


class Quantity(StrEnum):
    """What gels are coloured by."""

    STRESS = "stress"  # von Mises stress
    DISPLACEMENT = "displacement"  # distance from the undeformed gel


@dataclass(frozen=True, kw_only=True)
class Colouring:
    """A quantity with its scale.

    Attributes:
        label: for the colour bar, with the unit.
        lowest: lower end of the scale, in that unit.
        highest: upper end.
        values: at the nodes of both gels for every moment, in that unit.
    """

    label: str
    lowest: float
    highest: float
    values: tuple[tuple[FloatArray, FloatArray], ...]


def colouring(playback: Playback, quantity: Quantity) -> Colouring:
    """Return the quantity at all moments, on one scale that 98 % of the values are within."""
    values = tuple(
        (_values(playback, moment, 0, quantity), _values(playback, moment, 1, quantity)) for moment in playback.moments
    )
    label = "von Mises stress [kPa]" if quantity is Quantity.STRESS else "displacement [mm]"
    low, high = np.quantile(np.concatenate([gel for pair in values for gel in pair]), _WITHIN).tolist()
    lowest, highest = round_limits(low, high)
    return Colouring(label=label, lowest=lowest, highest=highest, values=values)


def round_limits(low: float, high: float) -> tuple[float, float]:
    """Return limits around a range that are multiples of a step: 1, 2 or 5 times a power of ten, about a tenth."""
    if not high > low:
        return low, low + 1.0
    power = 10.0 ** floor(log10((high - low) / 10.0))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if 10.0 * factor * power >= 0.999 * (high - low))
    return step * floor(low / step + _ROUNDING), step * ceil(high / step - _ROUNDING)


def _values(playback: Playback, moment: Moment, gel: int, quantity: Quantity) -> FloatArray:
    """Return nodal values of a gel: stress in kPa (mean of the tetrahedra around a node) or displacement in mm."""
    mesh, nodes_m = playback.gel, moment.gel_nodes_m[gel]
    if quantity is Quantity.DISPLACEMENT:
        pose = moment.sensor_poses[gel]
        return 1e3 * displacement_m(mesh.rest_position_m, nodes_m, pose.rotation, pose.centre_m)
    stress_pa = cauchy_stress_pa(
        deformation_gradients(mesh.rest_position_m, nodes_m, mesh.tetrahedra),
        youngs_modulus_pa=playback.physics.youngs_modulus_pa,
        poisson_ratio=playback.physics.poisson_ratio,
    )
    return 1e-3 * nodal_means(von_mises_pa(stress_pa), mesh.rest_position_m, mesh.tetrahedra)
