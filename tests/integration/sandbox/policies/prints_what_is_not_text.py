# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(1, b"\xff\xfe\x00\x1b[31m\r\n\x07")
        return [0.0, 0.0, 0.0]
