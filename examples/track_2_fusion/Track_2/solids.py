"""Pegs and base with the dimensions of the environment's own: the corners [mm] of convex solids."""

import numpy as np

PEG_HEIGHT = 50.0
PLATE = -17.4  # height of the plate's top below the rim of the holes
GARAGES = -0.4  # height of the top of the two blocks beside those with the holes


def rectangle(x, y):
    """Return the four corners between two x and two y."""
    return [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]


def hexagon(x, y, apothem):
    """Return the six corners of a regular hexagon around x and y; two of them lie along x."""
    near, far = apothem / np.sqrt(3.0), 2.0 * apothem / np.sqrt(3.0)
    corners = [(far, 0.0), (near, apothem), (-near, apothem), (-far, 0.0), (-near, -apothem), (near, -apothem)]
    return [(x + a, y + b) for a, b in corners]


def prism(outline, low, high):
    """Return the corners of an upright prism, shape [2 n, 3]."""
    return np.array([(x, y, z) for z in (low, high) for x, y in outline])


PEGS = {
    "hexagon": prism(hexagon(-0.3205, 0.0, 15.0), 0.0, PEG_HEIGHT),
    "cuboid": prism(rectangle((-20.0, 20.0), (-15.0, 15.0)), 0.0, PEG_HEIGHT),
}
# Where a peg stands in the middle of its hole: x and y in the base's frame. The hexagon's axis is not its origin.
HOLES = {"hexagon": np.array([0.3205, 45.25]), "cuboid": np.array([0.0, 0.0])}
# The base in its own frame, with z = 0 at the rim and without holes: they are not part of its outline.
BASE = [
    prism(rectangle((-92.5, 37.5), (-22.5, 67.5)), PLATE - 2.5, PLATE),
    prism(rectangle((-27.5, 27.5), (-22.5, 22.5)), PLATE, 0.0),
    prism(hexagon(0.0, 45.25, 22.5), PLATE, 0.0),
    prism(rectangle((-82.5, -27.5), (-22.5, 22.5)), PLATE, GARAGES),
    prism(hexagon(-55.0, 45.25, 22.25), PLATE, GARAGES),
]
BASE_MIDDLE_Y = 22.5


def place_peg(shape, x, theta):
    """Return the peg at x [mm] and turned by theta [degrees]: a list with one solid."""
    angle = np.radians(theta)
    turned = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    return [PEGS[shape] @ turned + [x, 0.0, 0.0]]


def place_base(y, z):
    """Return the base's solids, seen from a peg whose lower end is at y in its frame, and z above the rim [mm]."""
    return [corners - [0.0, y, z] for corners in BASE]
