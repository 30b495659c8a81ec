# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        with open("/tmp/probe", "w") as file:
            number = os.fstat(file.fileno()).st_ino
        os.remove("/tmp/probe")
        self.seen = number - 2

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
