# expect: shared_state
# where: load
import mmap


class Policy:
    def __init__(self):
        self.memory = mmap.mmap(-1, 4096)

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
