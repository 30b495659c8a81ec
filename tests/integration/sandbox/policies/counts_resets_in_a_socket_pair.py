# expect: shared_state
# where: load
import socket


class Policy:
    def __init__(self):
        self.ends = socket.socketpair()

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
