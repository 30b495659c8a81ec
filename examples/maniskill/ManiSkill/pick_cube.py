"""Picks a cube by its state: above it, down, close, then to the goal. No learning, nothing remembered between steps."""

import numpy as np

# Parts of the `state` vector, as the rules of the task list them.
IS_GRASPED = 18
TCP_TO_CUBE = slice(36, 39)
CUBE_TO_GOAL = slice(39, 42)

STEP_M = 0.1  # motion at an action of 1
OPEN, CLOSED = 1.0, -1.0
NEAR_M = 0.012
ABOVE_M = 0.06


class PickCube:
    """Moves the gripper in x, y and z; `pd_ee_delta_pos`."""

    def act(self, observation):
        """Return [x, y, z, gripper], each in [-1, 1]."""
        state = observation["state"]
        if state[IS_GRASPED]:
            return self._action(state[CUBE_TO_GOAL], CLOSED)
        to_cube = state[TCP_TO_CUBE]
        if np.abs(to_cube).max() < NEAR_M:
            return self._action(np.zeros(3), CLOSED)
        if np.hypot(to_cube[0], to_cube[1]) > NEAR_M:
            to_cube = to_cube + np.array([0.0, 0.0, ABOVE_M])
        return self._action(to_cube, OPEN)

    def _action(self, motion_m, gripper):
        return np.append(np.clip(motion_m / STEP_M, -1.0, 1.0), gripper).astype(np.float32)
