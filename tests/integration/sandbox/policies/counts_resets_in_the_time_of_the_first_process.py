# expect: harmless
# where: episode
import time


class Policy:
    def reset(self, task):
        try:
            self.seen = time.clock_gettime((~1 << 3) | 2)
        except OSError:
            self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
