# expect: bad_action_type
# where: episode
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return np.array([object(), None, 1], dtype=object)
