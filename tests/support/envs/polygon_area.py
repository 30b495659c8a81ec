"""Areas of polygons, to compare shapes with; imported by tests."""

import numpy as np
from vitac.envs.geometry.solid import Polygon


def signed_area(polygon: Polygon) -> float:
    """Return the enclosed area, positive when the corners run counter-clockwise; unit of the corners, squared."""
    following = np.roll(polygon, -1, axis=0)
    return float(0.5 * (polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]).sum())
