# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        try:
            with open("/submission/count", "ab+") as file:
                file.seek(0)
                self.seen = len(file.read())
                file.write(b"x")
        except OSError:
            self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
