# expect: harmless
# where: episode
import os


class Policy:
    def __init__(self):
        self.file = os.open(__file__, os.O_RDONLY)

    def reset(self, task):
        self.seen = os.lseek(self.file, 0, os.SEEK_CUR)
        os.lseek(self.file, 1, os.SEEK_CUR)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
