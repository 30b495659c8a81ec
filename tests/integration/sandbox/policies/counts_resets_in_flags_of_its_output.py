# expect: harmless
# where: episode
import fcntl
import os


class Policy:
    def reset(self, task):
        self.seen = int(bool(fcntl.fcntl(1, fcntl.F_GETFL) & os.O_NONBLOCK))
        fcntl.fcntl(1, fcntl.F_SETFL, os.O_NONBLOCK | os.O_WRONLY)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
