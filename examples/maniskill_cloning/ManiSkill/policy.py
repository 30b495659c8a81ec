"""A small network, in torch, that imitates the scripted policy of examples/maniskill; `train.py` made its weights."""

from pathlib import Path

import numpy as np
import torch

WEIGHTS = Path(__file__).parent / "weights.npz"
HIDDEN = 128
INPUTS, ACTIONS = 42, 4  # of `pick-cube`


def network():
    """Return the network without its weights."""
    return torch.nn.Sequential(
        torch.nn.Linear(INPUTS, HIDDEN), torch.nn.ReLU(),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.ReLU(),
        torch.nn.Linear(HIDDEN, ACTIONS),
    )  # fmt: skip


class Policy:
    """Acts by the state of the env step alone."""

    def __init__(self):
        torch.set_num_threads(1)
        self._network = network()
        with np.load(WEIGHTS) as stored:
            self._mean, self._scale = stored["mean"], stored["scale"]
            weights = {name: torch.from_numpy(stored[name]) for name in self._network.state_dict()}
        self._network.load_state_dict(weights)

    def reset(self, task):
        """Nothing is kept between episodes."""

    @torch.no_grad()
    def act(self, observation):
        """Return [x, y, z, gripper], each in [-1, 1]; the gripper opens or closes and never waits between."""
        normal = (observation["state"] - self._mean) / self._scale
        action = self._network(torch.from_numpy(normal)).clamp(-1.0, 1.0).numpy()
        action[3] = 1.0 if action[3] > 0 else -1.0
        return action
