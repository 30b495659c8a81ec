"""Presses the connector lightly, feels which way its boot turns, moves the other way, and pushes where nothing resists.

The neck of the boot passes little on, so three presses are felt together: a connector on the edge of the hole twists
both gels about y, and about x it presses the upper part of one gel and the lower part of the other. Both are seen in
how the motion of the markers differs between the sensors. Needs only NumPy.
"""

import numpy as np

SCALE_MM = 1.0
PRESSES_MM = (-0.8, -1.1, -1.4)  # heights; the last one bends a boot beside the hole by 1 mm
ABOVE_MM = -0.1
FREE_PX = 0.7  # mean motion of the markers upwards, less than of a connector that stands on the plate
# Offset [mm] for slopes of the motion [pixel in 100 pixels], the left sensor's less the right one's.
X_MM, Y_MM = (-3.2, 0.9), (5.0, -3.5)
LONGEST_MM = 2.5


class Policy:
    """Keeps what the presses of one place have shown, and what is left of the way from there."""

    def reset(self, task):
        """Begin an episode."""
        self.way, self.felt, self.is_over = np.zeros(2), [], False

    def act(self, observation):
        """Press in three steps, then move up and away from the side that is supported, or push on into the hole."""
        flow, height = observation["marker_flow"].astype(float), observation["relative_motion"][2]
        left, right = (motion(*sensor) for sensor in flow)
        if np.abs(self.way).max() > 0.1:
            return self.move(height)
        if self.is_over:
            return np.array([0.0, 0.0, -1.0], dtype=np.float32)
        self.felt.append((left - right)[1:])
        if height > PRESSES_MM[-1] + 0.05:
            lower = next(press for press in PRESSES_MM if press < height - 0.05)
            return np.array([0.0, 0.0, np.clip((lower - height) / SCALE_MM, -1.0, 1.0)], dtype=np.float32)
        if 0.5 * (left[0, 0] + right[0, 0]) < FREE_PX:
            self.is_over = True
            return np.array([0.0, 0.0, -1.0], dtype=np.float32)
        (uu, vu), (uv, vv) = np.mean(self.felt[-len(PRESSES_MM) :], axis=0).T
        offset = np.array([np.dot(X_MM, (uv, vu)), np.dot(Y_MM, (uu, vv))])
        self.way, self.felt = -np.clip(offset, -LONGEST_MM, LONGEST_MM), []
        return self.move(height)

    def move(self, height):
        """Go a step of the way, above the plate."""
        step = np.clip(self.way, -SCALE_MM, SCALE_MM)
        self.way = self.way - step
        up = np.clip(ABOVE_MM - height, -SCALE_MM, SCALE_MM)
        return (np.append(step, up) / SCALE_MM).astype(np.float32)


def motion(before, after):
    """Return the mean motion of the seen markers, and its slopes along u and v per 100 pixels, shape [3, 2]."""
    seen = 1 + np.argmax((before == before[-1]).all(axis=1))
    from_middle = (before[:seen] - (160.0, 120.0)) / 100.0
    u, v = from_middle.T
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    return np.linalg.lstsq(terms, after[:seen] - before[:seen], rcond=None)[0][:3]
