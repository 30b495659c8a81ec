# expect: bad_action_shape
# where: episode
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return np.zeros(10_000_000)
