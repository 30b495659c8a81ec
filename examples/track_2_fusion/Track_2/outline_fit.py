"""Finds the place of solids whose outline a picture shows.

The borders between pixels are up to half a pixel (0.4 mm) off the true outline, but a few hundred of them along slanted
edges give its place to a few hundredths of a millimetre. Two numbers are found at a time by the Gauss-Newton method:
every border belongs to the nearest edge of the expected outline, and the numbers are corrected until they lie on them.
"""

import numpy as np
from camera import project

STEP = 0.01  # mm or degrees: for the slopes
OUTLIER = 1.5  # pixels
FARTHEST = 10.0  # mm or degrees: one correction goes no farther


def fit_outline(borders, place, guess, rounds):
    """Return the two numbers at which an outline fits best.

    Args:
        borders: points of the picture [column, row], shape [n, 2].
        place: returns the corners of convex solids for two numbers, a list of arrays of shape [k, 3].
        guess: the two numbers to begin with.
        rounds: number of corrections.
    """
    found = np.array(guess, dtype=np.float64)
    for _ in range(rounds):
        solids = place(*found)
        edges = outline_edges(solids)
        ends = edge_ends(solids, edges)
        nearest = nearest_edges(borders, ends)
        distances = from_lines(borders, ends[nearest])
        slopes = [
            (from_lines(borders, edge_ends(place(*found + step), edges)[nearest]) - distances) / STEP
            for step in np.diag([STEP, STEP])
        ]
        near = np.abs(distances) < max(OUTLIER, 2.0 * np.median(np.abs(distances)))
        correction = np.linalg.lstsq(np.stack(slopes, axis=1)[near], distances[near], rcond=None)[0]
        found -= np.clip(correction, -FARTHEST, FARTHEST)
    return found


def misfit(borders, solids):
    """Return how far borders are from the outline of solids in the mean [pixels]; none counts more than `OUTLIER`."""
    ends = edge_ends(solids, outline_edges(solids))
    distances = from_lines(borders, ends[nearest_edges(borders, ends)])
    return np.minimum(np.abs(distances), OUTLIER).mean()


def outline_edges(solids):
    """Return the solid and the two corners of every edge of the solids' outlines, as indices, shape [e, 3]."""
    edges = []
    for solid, corners in enumerate(solids):
        hull = convex_hull(project(corners).tolist())
        edges += [(solid, first, second) for first, second in zip(hull, hull[1:] + hull[:1], strict=True)]
    return np.array(edges)


def edge_ends(solids, edges):
    """Return where edges begin and end in the picture, shape [e, 2, 2]."""
    counts = [len(corners) for corners in solids]
    first_corner = np.cumsum([0, *counts[:-1]])
    return project(np.concatenate(solids))[first_corner[edges[:, :1]] + edges[:, 1:]]


def nearest_edges(points, ends):
    """Return the number of the edge that is nearest to every point, shape [n]."""
    (u, v), (start_u, start_v), (along_u, along_v) = points.T, ends[:, 0].T, (ends[:, 1] - ends[:, 0]).T
    to_u, to_v = u[:, None] - start_u, v[:, None] - start_v
    share = np.clip((to_u * along_u + to_v * along_v) / (along_u**2 + along_v**2), 0.0, 1.0)
    return np.argmin((to_u - share * along_u) ** 2 + (to_v - share * along_v) ** 2, axis=1)


def from_lines(points, ends):
    """Return the signed distance of every point from the line through its own two ends, shape [n]."""
    along, to_point = ends[:, 1] - ends[:, 0], points - ends[:, 0]
    return (to_point[:, 0] * along[:, 1] - to_point[:, 1] * along[:, 0]) / np.hypot(along[:, 0], along[:, 1])


def convex_hull(points):
    """Return the indices of the corners of the points' convex hull, in order (Andrew's monotone chain)."""
    order = sorted(range(len(points)), key=points.__getitem__)
    return chain(points, order) + chain(points, order[::-1])


def chain(points, order):
    """Return one half of the hull, without its last corner, with which the other half begins."""
    corners = []
    for new in order:
        while len(corners) > 1 and not turns_left(points[corners[-2]], points[corners[-1]], points[new]):
            corners.pop()
        corners.append(new)
    return corners[:-1]


def turns_left(a, b, c):
    """Return whether the way from a over b to c turns to one side; straight on is no turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0])
