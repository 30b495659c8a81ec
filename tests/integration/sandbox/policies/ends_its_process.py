# expect: crashed
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os._exit(0)
