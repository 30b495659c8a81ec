# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.closerange(1, 3)
        return [0.0, 0.0, 0.0]
