"""What a pair of pictures shows: peg and base by their colour, their outlines, and their points by depth."""

import numpy as np
from camera import back_project
from solids import BASE_MIDDLE_Y

# The part of the picture in which peg, gels and base lie wherever the gripper is: rows and columns.
TOP, LEFT = 170, 225
CORNER = np.array([LEFT, TOP])
WINDOW = (slice(TOP, 360), slice(LEFT, 465))

BULGE = 2.3  # mm by which the peg's front stands before its sides: 4.4 measured for the hexagon, 0.2 for the cuboid
FREE_OF_GELS = (4.0, 28.0)  # mm above the lower end
MIDDLE, SIDES = 4.0, (8.0, 13.0)  # mm beside the peg's middle
FEWEST = 40  # pixels of an outline, or points by depth, below which a picture does not show a part


class Picture:
    """One observation's colour and depth.

    Attributes:
        peg, base, background: the pixels of each, in the window.
    """

    def __init__(self, rgb, depth):
        red, green, blue = np.moveaxis(rgb[WINDOW], 2, 0)
        self.peg = (red > 200) & (green < 100) & (blue < 100)
        self.base = (blue > 200) & (green < 100)
        self.background = (red > 220) & (green > 220) & (blue > 220)
        self.depth = depth[WINDOW]

    def points(self, mask):
        """Return the points [n, 3] that pixels show; those whose depth is unknown are left out."""
        rows, columns = np.nonzero(mask & (self.depth > 0))
        return back_project(rows + TOP, columns + LEFT, self.depth[rows, columns] * 1000.0)

    def shows_peg_and_base(self):
        """Return whether peg and base were found by their colours."""
        found = (self.peg_outline(), self.base_outline(), self.points(self.base))
        return min(len(points) for points in found) >= FEWEST

    def peg_outline(self):
        """Return where the peg ends before background and base; where it ends at a gel, the gel hides it."""
        return borders(self.peg, self.background | self.base)

    def base_outline(self):
        """Return where the base ends before the background; peg and gels hide the rest."""
        return borders(self.base, self.background)

    def peg_shape(self):
        """Return "hexagon" if the peg shows two faces with an edge between them, else "cuboid"."""
        x, y, z = self.points(self.peg).T
        free = (z > FREE_OF_GELS[0]) & (z < FREE_OF_GELS[1])
        sides = (free & (side * y > SIDES[0]) & (side * y < SIDES[1]) for side in (1, -1))
        faces = [x[face] for face in (free & (np.abs(y) < MIDDLE), *sides)]
        if min(len(face) for face in faces) == 0:
            return "cuboid"
        middle, left, right = (np.median(face) for face in faces)
        return "hexagon" if middle - (left + right) / 2 > BULGE else "cuboid"

    def rough_base_place(self):
        """Return y in the base's frame and z above the rim of the peg's lower end, each to about half a millimetre."""
        points = self.points(self.base)
        low, high = np.quantile(points[:, 1], [0.02, 0.98])
        rim = np.quantile(points[:, 2], 0.9)
        return np.array([BASE_MIDDLE_Y - (low + high) / 2, -rim])


def borders(inside, outside):
    """Return the middles [column, row] of the borders between pixels of one mask and of the other, shape [n, 2]."""
    width = inside.shape[1]
    points = []
    for first, second in ((inside, outside), (outside, inside)):
        rows, columns = np.divmod(np.flatnonzero(first[:, :-1] & second[:, 1:]), width - 1)
        points.append(np.stack([columns + 1.0, rows + 0.5], axis=1))
        rows, columns = np.divmod(np.flatnonzero(first[:-1] & second[1:]), width)
        points.append(np.stack([columns + 0.5, rows + 1.0], axis=1))
    return np.concatenate(points) + CORNER
