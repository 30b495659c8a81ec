# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        try:
            descriptor = os.open("/tmp", os.O_TMPFILE | os.O_RDWR)
            self.seen = os.fstat(descriptor).st_ino - 2
            os.close(descriptor)
        except OSError:
            self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
