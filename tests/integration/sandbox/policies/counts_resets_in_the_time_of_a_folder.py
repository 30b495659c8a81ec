# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        self.seen = int(os.stat("/tmp").st_mtime == 5)
        try:
            os.utime("/tmp", (5, 5))
        except OSError:
            pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
