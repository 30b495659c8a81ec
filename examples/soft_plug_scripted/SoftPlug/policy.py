"""Presses the plug on the plate, feels which side is supported, moves the other way, and pushes where it sinks in.

A plug that stands on the edge of the hole is turned in the grasp: about y it twists both gels, about x it presses the
upper part of one gel and the lower part of the other. Both are seen in how the motion of the markers differs between
the sensors. Needs only NumPy.
"""

import numpy as np

SCALE_MM = 1.0
PRESSED_PX = 4.0  # mean motion of the markers upwards, of about 3 N
IN_THE_HOLE_MM = -2.2  # lower than the plug can be pressed beside the hole
# Offset [mm] for slopes of the motion [pixel in 100 pixels], the left sensor's less the right one's.
X_MM, Y_MM = (-1.3, 0.65), (2.4, -1.4)


class Policy:
    """Keeps what is left of the way that the last touch has shown."""

    def reset(self, task):
        """Begin an episode."""
        self.way = np.zeros(2)

    def act(self, observation):
        """Go down until the plate is felt, then up and away from the side that it supports."""
        flow, height = observation["marker_flow"].astype(float), observation["relative_motion"][2]
        left, right = (motion(*sensor) for sensor in flow)
        if height < IN_THE_HOLE_MM:
            return np.array([0.0, 0.0, -1.0], dtype=np.float32)
        if 0.5 * (left[0, 0] + right[0, 0]) > PRESSED_PX:
            (uu, vu), (uv, vv) = (left - right)[1:].T
            offset = np.array([np.dot(X_MM, (uv, vu)), np.dot(Y_MM, (uu, vv))])
            self.way = -np.clip(offset, -2.0, 2.0)
        step = np.clip(self.way, -SCALE_MM, SCALE_MM)
        if np.abs(step).max() > 0.2:
            self.way = self.way - step
            up = np.clip(0.2 - height, 0.0, SCALE_MM)
            return (np.append(step, up) / SCALE_MM).astype(np.float32)
        down = 0.8 if height > -0.2 else 0.4
        return (np.array([0.0, 0.0, -down]) / SCALE_MM).astype(np.float32)


def motion(before, after):
    """Return the mean motion of the seen markers, and its slopes along u and v per 100 pixels, shape [3, 2]."""
    seen = 1 + np.argmax((before == before[-1]).all(axis=1))
    from_middle = (before[:seen] - (160.0, 120.0)) / 100.0
    u, v = from_middle.T
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    return np.linalg.lstsq(terms, after[:seen] - before[:seen], rcond=None)[0][:3]
