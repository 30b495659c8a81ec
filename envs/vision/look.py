"""How a scene looks: colours of its parts, light, and what else stands around."""

from dataclasses import dataclass
from math import radians, sqrt

import numpy as np
from numpy.typing import NDArray

from ..deterministic_math import sine_cosine
from ..fem.model.mesh import SurfaceMesh
from ..geometry.solid import prism_faces, rectangle, solid_from_faces
from .surfaces import Label

FloatArray = NDArray[np.float64]

LARGEST_CLUTTER = 8
# Where the middles of clutter may stand: in front of the base, and on its two sides; x and y from, to.
_CLUTTER_AREAS_MM = (
    ((60.0, 100.0), (-60.0, 110.0)),
    ((-80.0, 40.0), (-90.0, -50.0)),
    ((-80.0, 40.0), (95.0, 140.0)),
)
_CLUTTER_SIZES_MM = (8.0, 30.0)
_GROUND_MM = -2.5


@dataclass(frozen=True, kw_only=True)
class Look:
    """How pictures of a scene differ from the challenge's.

    Attributes:
        peg_hue_deg: turn of the peg's hue.
        base_hue_deg: turn of the base's hue.
        brightness: factor of all colours, of the background too.
        light_deg: turn of the direction of the light about the vertical.
        clutter: number of boxes around the base, rounded down; they have the colours of peg and base in turn.
    """

    peg_hue_deg: float = 0.0
    base_hue_deg: float = 0.0
    brightness: float = 1.0
    light_deg: float = 0.0
    clutter: float = 0.0


CHALLENGE_LOOK = Look()


def draw_clutter(look: Look, random: np.random.Generator) -> tuple[tuple[SurfaceMesh, Label], ...]:
    """Draw boxes with random places, angles and sizes: six numbers for each that there can be."""
    draws = random.random((LARGEST_CLUTTER, 6))[: int(look.clutter)]
    labels = (Label.CLUTTER_OF_BASE, Label.CLUTTER_OF_PEG)
    return tuple((_box(draw, _CLUTTER_AREAS_MM[k % 3]), labels[k % 2]) for k, draw in enumerate(draws))


def turned_hues(colours: FloatArray, labels: NDArray[np.uint8], look: Look) -> FloatArray:
    """Return the colours of triangles, shape [t, 3], 0 to 255, as they look; a hue is turned about the grey axis."""
    found = colours.copy()
    turns = (
        (look.peg_hue_deg, (Label.PEG, Label.CLUTTER_OF_PEG)),
        (look.base_hue_deg, (Label.BASE, Label.CLUTTER_OF_BASE)),
    )
    for turn_deg, turned in turns:
        chosen = np.isin(labels, turned)
        red, green, blue = colours[chosen].T
        for channel, row in enumerate(_about_grey(turn_deg)):
            found[chosen, channel] = row[0] * red + row[1] * green + row[2] * blue
    return np.asarray(np.clip(look.brightness * found, 0.0, 255.0))


def light_direction(look: Look) -> tuple[float, float, float]:
    """Return the direction towards the light; the challenge's shines along (0, -1, -1)."""
    sine, cosine = sine_cosine(radians(look.light_deg))
    return -sqrt(0.5) * sine, sqrt(0.5) * cosine, sqrt(0.5)


def _about_grey(turn_deg: float) -> FloatArray:
    """Return the rotation of colours about the axis from black to white (Rodrigues)."""
    sine, cosine = sine_cosine(radians(turn_deg))
    along, across = (1.0 - cosine) / 3.0, sine / sqrt(3.0)
    return np.array(
        [
            [cosine + along, along - across, along + across],
            [along + across, cosine + along, along - across],
            [along - across, along + across, cosine + along],
        ]
    )


def _box(draw: FloatArray, area_mm: tuple[tuple[float, float], tuple[float, float]]) -> SurfaceMesh:
    """Return an upright box on the ground, made of six numbers of 0 to 1."""
    smallest, largest = _CLUTTER_SIZES_MM
    length, width, height = (smallest + (largest - smallest) * draw[3:6]).tolist()
    middle = [low + (high - low) * part for (low, high), part in zip(area_mm, draw[:2].tolist(), strict=True)]
    sine, cosine = sine_cosine(radians(90.0 * float(draw[2])))
    x, y = rectangle(-0.5 * length, 0.5 * length, -0.5 * width, 0.5 * width).T
    turned = np.column_stack([cosine * x - sine * y, sine * x + cosine * y]) + middle
    return solid_from_faces(prism_faces(turned, _GROUND_MM, _GROUND_MM + height), "clutter")
