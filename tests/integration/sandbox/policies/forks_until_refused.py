# expect: too_many_processes
# where: episode
import os
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            if os.fork() == 0:
                time.sleep(60)
