"""Presses the key's teeth against the ceiling of the lock, pulls until they slip into their slots, and lifts.

While the teeth are held down, the handle rotates between the gels, and the markers with it. Nothing is learned; the
three numbers below were chosen by hand. Needs only NumPy.
"""

import numpy as np

MAX_MOTION = np.array([2.0, 1.0])  # mm inwards and down: motion of an action of 1
PULL = 1.5  # mm outwards in one env step; the narrowest lock holds its key only along 2 mm
PRESS = 1.6  # mm upwards in the first two env steps: the ceiling is 1 mm above the teeth
PRESSED = 0.006  # rotation of the markers [rad]; 0.010 to 0.016 under the ceiling, noise of 0.001 in a slot


class Policy:
    """Counts env steps; nothing else is stored."""

    def reset(self, task):
        """Begin an episode."""
        self.env_step = 0

    def act(self, observation):
        """Pull while the teeth are held down, else lift."""
        self.env_step += 1
        if self.env_step == 1:
            return action(pull=PULL, lift=1.0)
        if self.env_step == 2:
            return action(lift=PRESS - 1.0)
        if handle_rotation(observation["marker_flow"]) > PRESSED:
            return action(pull=PULL)
        return action(lift=1.0)


def handle_rotation(marker_flow):
    """Return the rotation of the handle between the gels, its tip downwards [rad].

    The right sensor looks from the other side and sees the opposite rotation.
    """
    left, right = (rotation(reference, current) for reference, current in marker_flow)
    return (right - left) / 2


def rotation(reference, current):
    """Return the rotation that fits the markers' motion best, from u to v [rad].

    The last marker is repeated to fill the array; only its first copy counts.
    """
    seen = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    place = reference[:seen] - reference[:seen].mean(axis=0)
    motion = (current - reference)[:seen]
    return (place[:, 0] * motion[:, 1] - place[:, 1] * motion[:, 0]).sum() / (place**2).sum()


def action(pull=0.0, lift=0.0):
    """Return the action for a motion outwards and upwards [mm]; float32, each in [-1, 1]."""
    return np.array([-pull, -lift] / MAX_MOTION, dtype=np.float32)
