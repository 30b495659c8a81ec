"""Puts a peg into the hole of a box by their true poses: grasp by the tail, lift, align before the hole, push in."""

import numpy as np
from rotations import matrix, vector

# Parts of the `state` vector, as the rules of the task list them.
TCP = slice(18, 25)
PEG = slice(25, 32)
PEG_HALF_LENGTH = 32
HOLE = slice(35, 42)

STEP_M, STEP_RAD = 0.1, -0.1  # motion at an action of 1; ManiSkill turns against the sign of the angle
OPEN, CLOSED = 1.0, -1.0
GAIN = 1.5  # the arm moves less than commanded
ABOVE_M = 0.08
BEFORE_M = 0.03  # between the peg's head and the box
CLOSING_STEPS = 3
SETTLED_STEPS = 3
PUSH_M = 0.025
ASIDE_M = 0.003


class SidePegInsertion:
    """Moves and turns the gripper; `pd_ee_delta_pose`."""

    def __init__(self):
        self._stage = self._go_above
        self._closed_for = 0
        self._settled_for = 0

    def act(self, observation):
        """Return [x, y, z, rx, ry, rz, gripper], each in [-1, 1]."""
        state = observation["state"].astype(float)
        tcp, peg, hole = (Pose(state[part]) for part in (TCP, PEG, HOLE))
        return self._stage(tcp, peg, hole, state[PEG_HALF_LENGTH])

    def _go_above(self, tcp, peg, hole, half_length):
        grasp = place_grasp(tcp, peg, half_length)
        above = grasp.moved([0, 0, ABOVE_M])
        if tcp.is_near(above, 0.006, 0.04):
            self._stage = self._go_down
        return action(tcp, above, OPEN)

    def _go_down(self, tcp, peg, hole, half_length):
        grasp = place_grasp(tcp, peg, half_length)
        if tcp.is_near(grasp, 0.012, 0.1):
            self._stage = self._close
        return action(tcp, grasp, OPEN)

    def _close(self, tcp, peg, hole, half_length):
        self._closed_for += 1
        if self._closed_for == CLOSING_STEPS:
            self._stage = self._align
        return action(tcp, tcp, CLOSED)

    def _align(self, tcp, peg, hole, half_length):
        goal = hole.shifted_along_x(-2.0 * half_length - BEFORE_M)
        self._settled_for = self._settled_for + 1 if peg.is_near(goal, 0.003, 0.02) else 0
        if self._settled_for == SETTLED_STEPS:
            self._stage = self._push
        return action(peg, goal, CLOSED, tcp)

    def _push(self, tcp, peg, hole, half_length):
        along, *aside = hole.rotation.T @ (peg.position - hole.position)
        ahead = PUSH_M if np.abs(aside).max() < ASIDE_M else 0.0
        return action(peg, hole.shifted_along_x(along + ahead), CLOSED, tcp)


class Pose:
    """Position [m] and rotation matrix of a body."""

    def __init__(self, values, rotation=None):
        self.position = np.asarray(values[:3])
        self.rotation = matrix(values[3:]) if rotation is None else rotation

    def moved(self, by_m):
        """Return the pose moved in the frame of the base."""
        return Pose(self.position + by_m, self.rotation)

    def shifted_along_x(self, by_m):
        """Return the pose moved along its own x."""
        return self.moved(self.rotation[:, 0] * by_m)

    def is_near(self, other, distance_m, angle_rad):
        """Return whether both are closer than this; of the angle, that of the x axes."""
        angle = np.arccos(np.clip(self.rotation[:, 0] @ other.rotation[:, 0], -1.0, 1.0))
        return np.linalg.norm(self.position - other.position) < distance_m and angle < angle_rad


def place_grasp(tcp, peg, half_length):
    """Return where the gripper holds the peg: from above, near its tail, the fingers at its sides."""
    side = peg.rotation[:, 1] * np.sign(peg.rotation[:, 1] @ tcp.rotation[:, 1])
    down = np.array([0.0, 0.0, -1.0])
    rotation = np.stack([np.cross(side, down), side, down], axis=1)
    tail = peg.shifted_along_x(-max(0.05, half_length / 2 + 0.01))
    return Pose(tail.position, rotation)


def action(body, goal, gripper, tcp=None):
    """Return the action that moves a body, or the gripper that holds it, towards a pose."""
    turn = goal.rotation @ body.rotation.T
    motion = goal.position - body.position
    if tcp is not None:  # the gripper turns about its own middle, which is not that of the body
        motion = goal.position + turn @ (tcp.position - body.position) - tcp.position
    return np.concatenate(
        [
            np.clip(GAIN * motion / STEP_M, -1.0, 1.0),
            np.clip(GAIN * vector(turn) / STEP_RAD, -1.0, 1.0),
            [gripper],
        ]
    ).astype(np.float32)
