# expect: harmless
# where: episode
import fcntl
import os


class Policy:
    def __init__(self):
        self.file = os.open(__file__, os.O_RDONLY)

    def reset(self, task):
        self.seen = int(bool(fcntl.fcntl(self.file, fcntl.F_GETFL) & os.O_NONBLOCK))
        fcntl.fcntl(self.file, fcntl.F_SETFL, os.O_NONBLOCK)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
