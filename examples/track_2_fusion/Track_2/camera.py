"""Where the camera's pixels look, from the numbers in docs/environments.md.

Everything is in the rig frame [mm]: its axes are those of the world, x is the world's, and y and z are measured from
where the peg's lower end is commanded to be. The rig follows that place in y and z, so in this frame the camera stands
still, the peg stays at y = 0 and z = 0, and the base moves.
"""

import numpy as np

FOCAL = 604.3075  # pixels
CENTRE = np.array([317.2341, 233.7944])  # column and row of the optical axis
POSITION = np.array([371.0, 20.0, 249.0])  # mm
TILT = np.radians(143.75)  # about the world's y axis
# The picture's right, its down and the optical axis, one per row. The picture is upside down.
AXES = np.array([[0.0, -1.0, 0.0], [-np.sin(TILT), 0.0, -np.cos(TILT)], [np.cos(TILT), 0.0, -np.sin(TILT)]])


def project(points):
    """Return the place [column, row] in the picture of points [n, 3]; the middle of the first pixel is at 0.5, 0.5."""
    right, down, depth = AXES @ (points - POSITION).T
    return CENTRE + FOCAL * np.stack([right, down], axis=1) / depth[:, None]


def back_project(rows, columns, depth):
    """Return the points [n, 3] that pixels show at a depth [mm] along the optical axis."""
    right, down = (columns + 0.5 - CENTRE[0]) / FOCAL, (rows + 0.5 - CENTRE[1]) / FOCAL
    return POSITION + depth[:, None] * (np.stack([right, down, np.ones(len(rows))], axis=1) @ AXES)
