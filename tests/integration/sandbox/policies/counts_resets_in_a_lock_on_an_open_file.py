# expect: harmless
# where: episode
import fcntl
import os


class Policy:
    def __init__(self):
        self.file = open(__file__)

    def reset(self, task):
        with open(__file__) as other:
            try:
                fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.seen = 0
                fcntl.flock(other, fcntl.LOCK_UN)
            except OSError:
                self.seen = 1
        fcntl.flock(self.file, fcntl.LOCK_EX)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
