# expect: shared_state
# where: load
import mmap
import os


class Policy:
    def __init__(self):
        self.memory = mmap.mmap(os.open("/dev/zero", os.O_RDWR), 4096)

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
