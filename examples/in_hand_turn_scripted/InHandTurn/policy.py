"""Feels when the rod touches the edge, works out its angle from the way since, and how far it would turn back.

How far the markers are turned about the middle of the picture is the twist of the gels. The policy assumes that the rod
hung straight and was held at its nominal place, which is never quite true. Needs only NumPy.
"""

import numpy as np

STEP_MM = 5.0  # of an action of 1
SEARCH_MM = 3.0
TOUCHED_DEG = 0.8
LEVER_MM = 24.0
MM_PER_DEG = 0.65  # how far the gripper goes while the gels are twisted by a degree and the rod does not slide
ASIDE_MM = 1.2  # by how much the rod is pushed aside in the hand
RETURNED = 0.92  # part of the twist by which the rod turns back
CAUTION = 0.7  # what was turned too far cannot be turned back


def twist_deg(marker_flow):
    """Return the mean turn of the markers of both sensors, positive as the rod turns."""
    turns = []
    for before, after in marker_flow:
        place, motion = before - before.mean(axis=0), after - before
        motion = motion - motion.mean(axis=0)
        turns.append((place[:, 0] * motion[:, 1] - place[:, 1] * motion[:, 0]).sum() / (place**2).sum())
    return np.degrees(0.5 * (turns[1] - turns[0]))


class Policy:
    """Remembers where the rod touched the edge, and the last twists, whose mean has less noise."""

    def reset(self, task):
        """Begin an episode."""
        self.touched_mm, self.free_mm, self.twists = None, 0.0, []

    def act(self, observation):
        """Search for the edge, then press until the rod would turn back to its goal."""
        x_mm, twist = observation["relative_motion"][0], twist_deg(observation["marker_flow"])
        if self.touched_mm is None:
            if twist < TOUCHED_DEG:
                self.free_mm = x_mm
                return np.array([SEARCH_MM / STEP_MM, 0.0], dtype=np.float32)
            self.touched_mm = max(self.free_mm, x_mm - MM_PER_DEG * twist)
        self.twists = [*self.twists[-3:], twist]
        angle = np.arctan((x_mm - self.touched_mm - ASIDE_MM) / LEVER_MM)
        left = np.radians(observation["goal_angle"][0] + RETURNED * np.mean(self.twists)) - angle
        way_mm = CAUTION * LEVER_MM * left / np.cos(angle) ** 2
        return np.array([np.clip(way_mm / STEP_MM, 0.0, 1.0), 0.0], dtype=np.float32)
