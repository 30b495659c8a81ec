# expect: bad_action_shape
# where: episode
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return np.zeros((1, 3), dtype=np.float32)
