# expect: shared_state
# where: load
import tempfile


class Policy:
    def __init__(self):
        self.file = tempfile.TemporaryFile()

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
