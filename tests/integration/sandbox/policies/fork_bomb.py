# expect: too_many_processes
# where: episode
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            try:
                os.fork()
            except OSError:
                pass
