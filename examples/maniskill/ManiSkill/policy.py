"""Plays each task by a script of its own, from the true poses in the state. No learning."""

from pick_cube import PickCube
from side_peg_insertion import SidePegInsertion

SCRIPTS = {"pick-cube": PickCube, "side-peg-insertion": SidePegInsertion}


class Policy:
    """Chooses the script by the task's name."""

    def reset(self, task):
        """Begin an episode of the task."""
        self._script = SCRIPTS[task]()

    def act(self, observation):
        """Return the action of the script."""
        return self._script.act(observation)
