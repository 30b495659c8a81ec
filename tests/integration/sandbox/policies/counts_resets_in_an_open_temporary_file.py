# expect: shared_state
# where: load
import os


class Policy:
    def __init__(self):
        self.file = open("/tmp/count", "w+")

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
