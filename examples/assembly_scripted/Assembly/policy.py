"""Closes on the part, feels where it is held and how it is turned, and plays all motions about its axis.

How far the markers spread up and down, and to the side, along x, says where the head is; what both sensors see of this
differently says how it is turned. The weights of both are linear and made by `fit.py`. Needs only NumPy.
"""

import numpy as np

STEP = np.array([6.0, 3.0, 3.0, 6.0])  # x, y, z [mm] and theta [deg] at an action of 1
CLOSED_MM, SOCKET_MM = 29.7, 26.0
CARRIED_MM, INSERTED_MM, TURNED_DEG = 4.1, -4.9, 60.0  # heights of the gripper above the start
PLACES = np.linspace(-90.0, 90.0, 7)  # along x from the middle of the picture [px]
WEIGHTS = np.array(
    [
        [-6.973, -12.255, 1.438, -11.1, 10.392, 3.304, 4.513, 1.574, -0.065, 1.502, -1.069, 1.77, -0.181, 1.756, 1.318],
        [-6.384, -3.511, 2.676, 6.598, -12.203, 6.252, 5.762, 1.923, 0.583, -0.616, -1.918, 0.206, 1.703, 0.427, 0.457],
    ]
)  # of x [mm] and theta [deg]: 14 features and a constant


def features(marker_flow):
    """Return what both sensors see alike, and differently: how the markers spread and move aside, shape [2, 14]."""
    spread, aside = [], []
    for side, (before, after) in zip((-1.0, 1.0), marker_flow, strict=True):
        up, x, motion = before[:, 0] - before[:, 0].mean(), side * (before[:, 1] - 125.0), after - before
        near = np.exp(-0.5 * ((x[:, None] - PLACES) / 20.0) ** 2)
        spread.append((near * (motion[:, 0] * up)[:, None]).sum(axis=0) / (near * (up**2)[:, None]).sum(axis=0))
        aside.append(side * (near * motion[:, 1:]).sum(axis=0) / near.sum(axis=0))
    most = np.abs(spread[0] + spread[1]).sum()
    alike = [(spread[0] + spread[1]) / most, (aside[0] + aside[1]) / 8.0]
    differently = [(spread[0] - spread[1]) / most, (aside[0] - aside[1]) / 8.0]
    return np.array([np.concatenate(alike), np.concatenate(differently)])


class Policy:
    """Remembers where it holds the part, and which of its motions it plays."""

    def reset(self, task):
        """Begin an episode."""
        self.held, self.phase = None, 0

    def act(self, observation):
        """Close on the part, feel it, then lift, carry, lower and turn it."""
        to_close_mm = observation["gripper_width"][0] - CLOSED_MM
        if to_close_mm > 1e-3:
            return np.array([0.0, 0.0, 0.0, 0.0, -min(1.0, to_close_mm / 2.0)], dtype=np.float32)
        if self.held is None:
            seen = features(observation["marker_flow"])
            self.held = (seen * WEIGHTS[:, :-1]).sum(axis=1) + WEIGHTS[:, -1]
        now = observation["relative_motion"]
        goals = [
            np.array([now[0], now[1], CARRIED_MM, now[3]]),
            self.place(CARRIED_MM, 0.0),
            self.place(INSERTED_MM, 0.0),
            self.place(INSERTED_MM, TURNED_DEG),
        ]
        while self.phase < 3 and np.abs(goals[self.phase] - now).max() < 0.02:
            self.phase += 1
        way = goals[self.phase] - now
        if self.phase == 3:
            turn = np.clip(way[3], -STEP[3], STEP[3])
            way = self.place(INSERTED_MM, now[3] + turn + self.held[1]) - now
        action = way / STEP
        return np.append(action / max(1.0, np.abs(action).max()), 0.0).astype(np.float32)

    def place(self, z_mm, turn_deg):
        """Return where the gripper has to be for the part to be over the socket at this height, turned by this."""
        x_mm, held_deg = self.held
        angle = np.radians(turn_deg - held_deg)
        return np.array([SOCKET_MM - x_mm * np.cos(angle), -x_mm * np.sin(angle), z_mm, turn_deg - held_deg])
