"""How pictures look: colours, light, what stands around the base, and noise of pixels."""

from dataclasses import dataclass
from math import radians, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..deterministic_math import sine_cosine
from ..fem.model.mesh import SurfaceMesh
from ..geometry.solid import prism_faces, rectangle, solid_from_faces
from .rasterizer import IndexArray, Label, RenderedView, VisibleSurfaces

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
# Of table and wall, which fill the picture wherever the rig can stand: x where they meet, and how far they reach.
_WALL_X_MM, _REACH_MM = -250.0, 1500.0


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


class Rectangle(NamedTuple):
    """A flat rectangle."""

    vertices_m: FloatArray  # [4, 3] [m]
    triangles: IndexArray  # [2, 3] counter-clockwise seen from outside


def build_surroundings() -> tuple[tuple[Rectangle, Label], ...]:
    """Return the table that the base stands on, and the wall behind it as the rig looks."""
    near, far, low, high = _WALL_X_MM + _REACH_MM, _WALL_X_MM, _GROUND_MM, _GROUND_MM + _REACH_MM
    left, right = -_REACH_MM, _REACH_MM
    table = np.array([(far, left, low), (near, left, low), (near, right, low), (far, right, low)])
    wall = np.array([(far, left, low), (far, right, low), (far, right, high), (far, left, high)])
    halves = np.array([(0, 1, 2), (0, 2, 3)])
    return (Rectangle(1e-3 * table, halves), Label.TABLE), (Rectangle(1e-3 * wall, halves), Label.WALL)


def turned_hues(colours: FloatArray, labels: NDArray[np.uint8], look: Look) -> FloatArray:
    """Return the colours of triangles, shape [t, 3], 0 to 255, as they look; a hue is turned about the grey axis."""
    colours_turned = colours.copy()
    turns = (
        (look.peg_hue_deg, (Label.PEG, Label.CLUTTER_OF_PEG)),
        (look.base_hue_deg, (Label.BASE, Label.CLUTTER_OF_BASE)),
    )
    for turn_deg, turned in turns:
        chosen = np.isin(labels, turned)
        red, green, blue = colours[chosen].T
        for channel, row in enumerate(_about_grey(turn_deg)):
            colours_turned[chosen, channel] = row[0] * red + row[1] * green + row[2] * blue
    return np.asarray(np.clip(look.brightness * colours_turned, 0.0, 255.0))


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


# Mean and standard deviation of the sum of eight random bytes.
_BYTES_MEAN = 8 * 127.5
_BYTES_SD = sqrt(8 * (256.0**2 - 1.0) / 12.0)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# Every second byte, and what a product adds four numbers of two bytes with.
_EVEN_BYTES = np.uint64(0x00FF00FF00FF00FF)
_ADD_FOUR = np.uint64(0x0001000100010001)


@kernel
def draw_noise(key: np.uint64, counter: np.uint64) -> float:
    """Return a number that is nearly standard normal: the sum of the eight bytes of a mixed counter, scaled.

    The mixer is splitmix64 (Steele, Lea & Flood 2014). A counter rather than a stream, so that the noise of a pixel
    does not depend on how many others show something.
    """
    z = key + (counter + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    pairs = (z & _EVEN_BYTES) + ((z >> np.uint64(8)) & _EVEN_BYTES)
    total = (pairs * _ADD_FOUR) >> np.uint64(48)
    return (float(total) - _BYTES_MEAN) / _BYTES_SD


BACKGROUND = (255, 255, 255)
# Red, green and blue of faces that look away from the light, and what is added for those that look at it. Within the
# ranges of the challenge's pictures, so that its colour rule finds peg and base in these too.
_DARK_AND_GAIN = {
    Label.BASE: ((16.0, 16.0, 255.0), (52.0, 52.0, 0.0)),
    Label.PEG: ((242.0, 4.0, 65.0), (13.0, 54.0, 20.0)),
    Label.LEFT_GEL: ((147.0, 255.0, 255.0), (13.0, 0.0, 0.0)),
    Label.RIGHT_GEL: ((147.0, 255.0, 255.0), (13.0, 0.0, 0.0)),
    Label.TABLE: ((110.0, 100.0, 88.0), (45.0, 42.0, 38.0)),
    Label.WALL: ((170.0, 172.0, 170.0), (50.0, 50.0, 48.0)),
}
_DARK_AND_GAIN |= {
    Label.CLUTTER_OF_BASE: _DARK_AND_GAIN[Label.BASE],
    Label.CLUTTER_OF_PEG: _DARK_AND_GAIN[Label.PEG],
}


def colour_picture(
    view: RenderedView, surfaces: VisibleSurfaces, vertices_m: FloatArray, look: Look = CHALLENGE_LOOK
) -> NDArray[np.uint8]:
    """Return the flat-lit picture on a white background, shape [height, width, 3], red, green, blue.

    Every triangle has one colour: its class's, brighter by (1 + n.l)/2 for normal n and direction to the light l.

    Args:
        view: which triangle every pixel shows.
        surfaces: the triangles' classes.
        vertices_m: vertices in the world [m], shape [n, 3].
        look: how it differs from the challenge's.
    """
    background = (look.brightness * np.array(BACKGROUND)).astype(np.uint8)
    picture = np.broadcast_to(background, (*view.triangle.shape, 3)).copy()
    colours = np.concatenate([_triangle_colours(surfaces, vertices_m, look), [background]]).astype(np.uint8)
    # Triangle -1 is the table's last row.
    picture[view.box] = colours[view.triangle[view.box]]
    return picture


def depth_picture(view: RenderedView) -> NDArray[np.float32]:
    """Return the exact distances along the optical axis [m], 0 where nothing is seen, shape [height, width]."""
    return view.depth_m.astype(np.float32)


def segmentation_picture(view: RenderedView, surfaces: VisibleSurfaces) -> NDArray[np.uint8]:
    """Return `Label` of every pixel, shape [height, width]."""
    picture = np.full(view.triangle.shape, Label.NOTHING, dtype=np.uint8)
    labels = np.append(surfaces.labels, np.uint8(Label.NOTHING))
    picture[view.box] = labels[view.triangle[view.box]]
    return picture


def _triangle_colours(surfaces: VisibleSurfaces, vertices_m: FloatArray, look: Look) -> FloatArray:
    """Return the colour of every triangle, shape [t, 3], 0 to 255."""
    normals = unit_normals(vertices_m, surfaces.triangles)
    to_light = light_direction(look)
    towards_light = normals[:, 0] * to_light[0] + normals[:, 1] * to_light[1] + normals[:, 2] * to_light[2]
    brightness = (1.0 + towards_light) / 2.0
    dark, gain = np.zeros((len(Label), 3)), np.zeros((len(Label), 3))
    for label, (dark_colour, added) in _DARK_AND_GAIN.items():
        dark[label], gain[label] = dark_colour, added
    colours = np.asarray(dark[surfaces.labels] + brightness[:, None] * gain[surfaces.labels])
    return colours if look == CHALLENGE_LOOK else turned_hues(colours, surfaces.labels, look)


def unit_normals(vertices_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return the outward unit normals of triangles, shape [t, 3]."""
    a, b, c = (vertices_m[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    squares = normals * normals
    lengths = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])
    return np.asarray(normals / lengths[:, None])
