"""A small policy whose actions depend on what it sees, so that a difference anywhere shows in the result hash.

It waits before each episode, so that tests which kill something in the middle of an evaluation are not too late.
"""

from service_client import make_archive

POLICY = """
import time
import numpy as np

class Policy:
    def reset(self, task):
        self.steps = 0
        time.sleep(0.15)

    def act(self, observation):
        self.steps += 1
        moved = observation["marker_flow"][:, 1] - observation["marker_flow"][:, 0]
        return np.clip(moved.mean(axis=(0, 1)).sum() * np.ones(3) / 20 + self.steps / 50, -1, 1).astype(np.float32)
"""
HONEST = make_archive(policy=POLICY)
