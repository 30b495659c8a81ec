# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        self.seen = int(os.stat("/tmp").st_mode & 0o001 == 0)
        try:
            os.chmod("/tmp", 0o1770)
        except OSError:
            pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
