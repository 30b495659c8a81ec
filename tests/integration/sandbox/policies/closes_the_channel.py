# expect: crashed
# where: episode
import os

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.close(channel())
        return [0.0, 0.0, 0.0]
