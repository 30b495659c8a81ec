# expect: harmless
# where: episode
import os
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                while True:
                    time.sleep(0.01)
            os._exit(0)
        return [0.0, 0.0, 0.0]
