"""Estimates twice where the hole is, moves there, and rocks the peg if it does not slip in.

A peg that is pressed on the rim of a hole tilts, which pulls the gels up or down and twists them. That shows the
direction of the hole well, its distance roughly, and the angle not at all. The marker flow after the first motion
corrects the estimate. `train.py` fits both regressions. Needs only NumPy.
"""

import json
from pathlib import Path

import numpy as np

MAX_MOTION = np.array([2.0, 2.0, 4.0])  # mm, mm, degrees: motion of an action of 1
STEPS_STRAIGHT = 3  # A peg that can go in straight has gone in by then; afterwards it is rocked.
IMAGE_CENTRE = np.array([160.0, 125.0])  # pixels


class Policy:
    """Estimates the start's offset from the hole [mm, mm, degrees]."""

    def __init__(self):
        regressions = json.loads((Path(__file__).parent / "weights.json").read_text())
        self.regressions = [{key: np.array(value) for key, value in regression.items()} for regression in regressions]

    def reset(self, task):
        """Begin an episode."""
        self.start = np.zeros(3)
        self.inputs = np.zeros(0)
        self.env_step = 0

    def act(self, observation):
        """Move from the estimated offset towards the hole."""
        motion = observation["relative_motion"][:3]
        if self.env_step < len(self.regressions):
            self.inputs = np.concatenate([features(observation["marker_flow"]), self.inputs, motion])
            self.start = self.start + read_offset(self.regressions[self.env_step], self.inputs)
        action = towards_hole(self.start, motion)
        self.env_step += 1
        if self.env_step > STEPS_STRAIGHT:
            action[2] = 1 if (self.env_step - STEPS_STRAIGHT) % 2 else -1
        return action


def features(marker_flow):
    """Return 24 features: affine parts of both gels' motion, their sums and differences, also saturated."""
    left, right = (affine_motion(reference, current) for reference, current in marker_flow)
    affine = np.concatenate([left + right, left - right])
    return np.concatenate([affine, np.tanh(2 * affine)])


def affine_motion(reference, current):
    """Fit the markers' motion by a constant and slopes over the image; return six numbers [pixel].

    The last marker is repeated to fill the array; only its first copy counts.
    """
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    motion = (current - reference)[:count].astype(np.float64)
    place = (reference[:count].astype(np.float64) - IMAGE_CENTRE) / 100
    columns = np.concatenate([np.ones((count, 1)), place], axis=1)
    return np.linalg.lstsq(columns, motion, rcond=None)[0].ravel()


def read_offset(regression, inputs):
    """Return the offset [mm, mm, degrees], or its correction, that a regression predicts."""
    normal = (inputs - regression["mean"]) / regression["scale"]
    return (normal[:, None] * regression["weights"]).sum(axis=0)


def towards_hole(start, motion):
    """Return the action that undoes the start's offset, as far as one env step can, after some motion of the gripper.

    The angle is not corrected: the gels do not show it. The gripper's own axes rotate with it.
    """
    angle = np.radians(motion[2])
    x, y = -(start + motion)[:2]
    own_axes = np.array([np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, 0.0])
    action = np.clip(own_axes / MAX_MOTION, -1, 1)
    # Rounded, so that differences in the last bits of another machine do not change the episode.
    return np.round(action, 3).astype(np.float32)
