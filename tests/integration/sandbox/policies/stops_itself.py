# expect: crashed
# where: episode
import os
import signal


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.kill(os.getpid(), signal.SIGSTOP)  # refused: job control is not for policies
