# expect: shared_state
# where: load
import multiprocessing


class Policy:
    def __init__(self):
        self.array = multiprocessing.RawArray("i", 1)

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
