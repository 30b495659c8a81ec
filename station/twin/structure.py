"""How a twin of class B differs from our simulation in structure; each difference can be switched off alone."""

from collections.abc import Collection
from enum import StrEnum
from functools import cache
from typing import Annotated, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.tactile.gel import GelCells, arena_gel_mesh, structured_gel
from vitac.evaluator.strict_model import StrictModel

from ..description import TwinClass

Pair = tuple[float, float]
Triple = tuple[float, float, float]
SixBySix = tuple[tuple[float, float, float, float, float, float], ...]


class Difference(StrEnum):
    """What a twin of class B has that our simulation has not, by its field of `HiddenStructure`."""

    MESH = "mesh"
    WEAKENING = "weakening"
    VISCOSITY = "viscosity"
    YEOH = "yeoh"
    COMPLIANCE = "compliance"
    TILT = "tilt"
    TOLERANCE = "tolerance_mm"
    BOND = "unbonded_mm"
    PRINT = "print"
    SHUTTER = "readout_s"
    BLUR = "exposure_s"
    JPEG = "jpeg_quality"
    LIGHT = "fading_h"
    WRENCH = "wrench"


class Weakening(StrictModel):
    """Friction that is less the faster bodies slide, see `envs.fem.contact.weakening`."""

    kinetic_ratio: Annotated[float, Field(gt=0, le=1)]
    speed_mm_s: PositiveFloat


class Branch(StrictModel):
    """A branch of the gels' Prony series."""

    modulus_ratio: NonNegativeFloat
    relaxation_time_s: PositiveFloat


class Compliance(StrictModel):
    """Springs and stick-slip of the mechanics."""

    stage_n_mm: PositiveFloat
    """Stiffness of each linear axis."""
    finger_n_mm: PositiveFloat
    """Stiffness of each finger along the direction in which it closes."""
    stick_mm: NonNegativeFloat
    """Way of a linear axis that its guide sticks for before it jumps after the drive."""


class Tilt(StrictModel):
    """Parts that do not stand or lie upright [deg]."""

    peg_deg: float
    """Of the peg between the gels, about the axis along which they close: about the other they press it upright."""
    plate_deg: Pair
    """About the world's x and y axes."""


class Print(StrictModel):
    """Markers that are printed off their grid."""

    shift_px: Pair
    turn_deg: float
    stretch: float
    """Of the columns' distance; that of the rows shrinks as much."""
    scatter_px: NonNegativeFloat
    """Standard deviation of a marker's place along u and v."""


class WrenchError(StrictModel):
    """Errors of the force/torque sensor."""

    hysteresis_n: NonNegativeFloat
    """By which a force that returns is seen too late; of a torque as many N m over 20."""
    crosstalk: SixBySix
    """What each number takes of each other one."""


class HiddenStructure(StrictModel):
    """Everything; without any of it, as by default, a twin is of class A."""

    mesh: bool = False
    """A gel of 784 nodes in place of 363: three layers, an odd number of cells, two cells across each bevel."""
    weakening: Weakening | None = None
    viscosity: tuple[Branch, ...] = ()
    yeoh: Pair | None = None
    """C20 and C30 over C10, see `envs.fem.elastic.yeoh`."""
    compliance: Compliance | None = None
    tilt: Tilt | None = None
    tolerance_mm: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """By how much the gap between peg and hole is wider than drawn."""
    unbonded_mm: Annotated[float, Field(ge=0, le=6)] = 0.0
    """Width of the strip at the gels' lower end that has come off its backing."""
    print: Print | None = None
    readout_s: NonNegativeFloat = 0.0
    """Time in which a rolling shutter reads a picture."""
    exposure_s: NonNegativeFloat = 0.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 95
    fading_h: Triple = (0.0, 0.0, 0.0)
    """Part of the blue, green and red light that is lost in an hour."""
    wrench: WrenchError | None = None

    def without(self, differences: Collection[Difference]) -> Self:
        """Return the same with some differences switched off."""
        return self.model_copy(update={name: type(self).model_fields[name].default for name in differences})

    @property
    def twin_class(self) -> TwinClass:
        """Class of the twin that has it."""
        return TwinClass.A if self == type(self)() else TwinClass.B


def draw_structure(generator: np.random.Generator) -> HiddenStructure:
    """Draw the structure of a twin of class B; docs/simulation-and-station.md has its sizes."""

    def between(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    def either(largest: float) -> float:
        return between(-largest, largest)

    crosstalk = generator.uniform(-0.02, 0.02, (6, 6)) * _UNITS
    np.fill_diagonal(crosstalk, 0.0)
    return HiddenStructure(
        mesh=True,
        weakening=Weakening(kinetic_ratio=between(0.7, 0.95), speed_mm_s=between(0.5, 5.0)),
        viscosity=(
            Branch(modulus_ratio=between(0.05, 0.2), relaxation_time_s=between(0.2, 1.0)),
            Branch(modulus_ratio=between(0.05, 0.15), relaxation_time_s=between(2.0, 8.0)),
        ),
        yeoh=(between(-0.1, 0.1), between(0.02, 0.08)),
        compliance=Compliance(
            stage_n_mm=between(150, 500), finger_n_mm=between(800, 2500), stick_mm=between(0.002, 0.008)
        ),
        tilt=Tilt(peg_deg=either(1.5), plate_deg=(either(1.5), either(1.5))),
        tolerance_mm=either(0.1),
        unbonded_mm=between(1.0, 3.0),
        print=Print(
            shift_px=(either(1.0), either(1.0)),
            turn_deg=either(0.5),
            stretch=either(0.01),
            scatter_px=between(0.5, 1.5),
        ),
        readout_s=between(0.01, 0.03),
        exposure_s=between(0.005, 0.02),
        jpeg_quality=int(generator.integers(60, 90)),
        fading_h=(between(0.0, 0.08), between(0.0, 0.08), between(0.0, 0.08)),
        wrench=WrenchError(hysteresis_n=between(0.02, 0.15), crosstalk=tuple(map(tuple, crosstalk.tolist()))),
    )


_LEVER_M: Final = 0.05
_SIZES: Final = np.array((1.0,) * 3 + (_LEVER_M,) * 3)
_UNITS: Final = _SIZES[:, None] / _SIZES
"""Of crosstalk: a force gives as much of a torque as it would at this lever."""


class FaultyWrench:
    """What a force/torque sensor with errors shows of a wrench."""

    def __init__(self, error: WrenchError) -> None:
        self._mixing = np.eye(6) + np.array(error.crosstalk)
        self._half = error.hysteresis_n * _SIZES
        self._at = np.zeros(6)

    def show(self, wrench: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what it shows now."""
        self._at = np.clip(self._at, wrench - self._half, wrench + self._half)
        return np.asarray(self._mixing @ self._at)


_CELLS: Final = GelCells(x=9, y=9, bevel=2, layers=3, is_hexahedral=True)


@cache
def twin_gel(structure: HiddenStructure) -> GelMesh:
    """Return the gel of a twin."""
    gel = structured_gel(name="gel of a twin of class B", cells=_CELLS) if structure.mesh else arena_gel_mesh()
    if not structure.unbonded_mm:
        return gel
    # The gels' x axes point down.
    loose = gel.rest_position_m[:, 0] > gel.rest_position_m[:, 0].max() - 1e-3 * structure.unbonded_mm
    return GelMesh(
        rest_position_m=gel.rest_position_m,
        tetrahedra=gel.tetrahedra,
        driven=gel.driven & ~loose,
        sensing=gel.sensing,
        name=f"{gel.name}, loose at its lower end",
        hexahedra=gel.hexahedra,
    )
