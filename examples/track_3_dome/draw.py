"""Draws the gel: a box of 25.25 x 20.75 mm, 3 mm high at the rim, whose top rises by 1 mm to the middle.

python draw.py          # writes Track_3/gel.stl
"""

import struct
from pathlib import Path

import numpy as np

LENGTH_MM, WIDTH_MM = 25.25, 20.75
RIM_MM, RISE_MM = 3.0, 1.0
CELLS = 10


def corners():
    """Return the triangles' corners, counter-clockwise seen from outside, shape [f, 3, 3] [mm]."""
    across = np.linspace(-1.0, 1.0, CELLS + 1)
    x, y = np.meshgrid(across, across, indexing="ij")
    height = RIM_MM + RISE_MM * (1.0 - x**2) * (1.0 - y**2)
    top = np.stack([0.5 * LENGTH_MM * x, 0.5 * WIDTH_MM * y, height], axis=-1)
    base = top * [1.0, 1.0, 0.0]
    quads = [*cells(top), *cells(base[::-1])]
    for rim in (np.s_[:, 0], np.s_[-1, :], np.s_[::-1, -1], np.s_[0, ::-1]):
        quads += [(base[rim][i], base[rim][i + 1], top[rim][i + 1], top[rim][i]) for i in range(CELLS)]
    return np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])


def cells(points):
    """Return the cells of a grid of points as quads, counter-clockwise for rising x and y."""
    return [
        (points[i, j], points[i + 1, j], points[i + 1, j + 1], points[i, j + 1])
        for i in range(CELLS)
        for j in range(CELLS)
    ]


def stl(triangles):
    """Return the bytes of a binary STL file; readers compute the normals."""
    records = (bytes(12) + triangle.astype("<f4").tobytes() + bytes(2) for triangle in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + b"".join(records)


if __name__ == "__main__":
    (Path(__file__).parent / "Track_3" / "gel.stl").write_bytes(stl(corners()))
