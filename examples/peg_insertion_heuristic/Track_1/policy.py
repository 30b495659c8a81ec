"""Feels twice to which side the hole lies, goes there, and rocks the peg if it does not slip in.

A peg that is pressed on the rim of a hole tilts, and the gels are pulled up or down and twisted. That tells well to
which side the hole lies, and roughly how far; it tells nothing about the angle. How the gels answer to the first motion
corrects that. `train.py` fitted how to read both. Needs only NumPy.
"""

import json
from pathlib import Path

import numpy as np

MAX_MOTION = np.array([2.0, 2.0, 4.0])  # mm, mm, degrees: what an action of 1 commands
STEPS_STRAIGHT = 3  # Whatever can go in at once has gone in by then; afterwards the peg is rocked.
IMAGE_CENTRE = np.array([160.0, 125.0])  # pixels


class Policy:
    """Keeps one estimate of the start's offset from the hole [mm, mm, degrees]."""

    def __init__(self):
        readings = json.loads((Path(__file__).parent / "weights.json").read_text())
        self.readings = [{key: np.array(value) for key, value in reading.items()} for reading in readings]

    def reset(self, task):
        """Forgets the last episode."""
        self.start = np.zeros(3)
        self.felt = np.zeros(0)
        self.env_step = 0

    def act(self, observation):
        """Move from where the peg is thought to be towards the hole."""
        motion = observation["relative_motion"][:3]
        if self.env_step < len(self.readings):
            self.felt = np.concatenate([features(observation["marker_flow"]), self.felt, motion])
            self.start = self.start + read_offset(self.readings[self.env_step], self.felt)
        action = towards_hole(self.start, motion)
        self.env_step += 1
        if self.env_step > STEPS_STRAIGHT:
            action[2] = 1 if (self.env_step - STEPS_STRAIGHT) % 2 else -1
        return action


def features(marker_flow):
    """Return 24 features: affine parts of both gels' motion, their sums and differences, also saturated."""
    left, right = (affine_motion(reference, current) for reference, current in marker_flow)
    felt = np.concatenate([left + right, left - right])
    return np.concatenate([felt, np.tanh(2 * felt)])


def affine_motion(reference, current):
    """Least-squares fit of the markers' motion by a constant and slopes over the image, six numbers [pixel].

    The last marker is repeated to fill the array; only its first copy counts.
    """
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    motion = (current - reference)[:count].astype(np.float64)
    place = (reference[:count].astype(np.float64) - IMAGE_CENTRE) / 100
    columns = np.concatenate([np.ones((count, 1)), place], axis=1)
    return np.linalg.lstsq(columns, motion, rcond=None)[0].ravel()


def read_offset(reading, felt):
    """Return the offset [mm, mm, degrees], or the correction of it, that the features speak for."""
    normal = (felt - reading["mean"]) / reading["scale"]
    return (normal[:, None] * reading["weights"]).sum(axis=0)


def towards_hole(start, motion):
    """Return the action that undoes the start's offset, as far as one env step can, after some motion of the gripper.

    The angle is left alone: it cannot be felt. What the gripper has turned by turns its own axes.
    """
    angle = np.radians(motion[2])
    x, y = -(start + motion)[:2]
    own_axes = np.array([np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, 0.0])
    action = np.clip(own_axes / MAX_MOTION, -1, 1)
    # Rounded, so that another machine's last bits do not make another episode.
    return np.round(action, 3).astype(np.float32)
