# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        self.seen = os.getpid() - 4

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
