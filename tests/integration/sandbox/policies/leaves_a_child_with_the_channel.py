# expect: crashed
# where: episode
import os
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        if os.fork() == 0:
            time.sleep(60)
        os._exit(0)
