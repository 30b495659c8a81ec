"""Pictures made of a camera's view: colour, depth and segmentation, as observations hold them (challenge-facts 4.1)."""

import numpy as np
from numpy.typing import NDArray

from .look import CHALLENGE_LOOK, Look, light_direction, turned_hues
from .rasterizer import View
from .surfaces import FloatArray, IndexArray, Label, VisibleSurfaces

BACKGROUND = (255, 255, 255)
# Red, green and blue of faces that look away from the light, and what is added for those that look at it. Within the
# ranges of the challenge's pictures (challenge-facts 15), so that its colour rule finds peg and base in these too.
_DARK_AND_GAIN = {
    Label.BASE: ((16.0, 16.0, 255.0), (52.0, 52.0, 0.0)),
    Label.PEG: ((242.0, 4.0, 65.0), (13.0, 54.0, 20.0)),
    Label.LEFT_GEL: ((147.0, 255.0, 255.0), (13.0, 0.0, 0.0)),
    Label.RIGHT_GEL: ((147.0, 255.0, 255.0), (13.0, 0.0, 0.0)),
}
_DARK_AND_GAIN |= {
    Label.CLUTTER_OF_BASE: _DARK_AND_GAIN[Label.BASE],
    Label.CLUTTER_OF_PEG: _DARK_AND_GAIN[Label.PEG],
}


def colour_picture(
    view: View, surfaces: VisibleSurfaces, vertices_m: FloatArray, look: Look = CHALLENGE_LOOK
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


def depth_picture(view: View) -> NDArray[np.float32]:
    """Return the exact distances along the optical axis [m], 0 where nothing is seen, shape [height, width]."""
    return view.depth_m.astype(np.float32)


def segmentation_picture(view: View, surfaces: VisibleSurfaces) -> NDArray[np.uint8]:
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
