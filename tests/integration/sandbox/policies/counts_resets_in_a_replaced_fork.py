# expect: harmless
# where: episode
import os

COUNT = [0]
FORK = os.fork


def counting_fork():
    COUNT[0] += 1
    return FORK()


os.fork = counting_fork


class Policy:
    def reset(self, task):
        self.seen = COUNT[0] - 1

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
