# expect: wall_time
# where: episode
# limits: action_wall_s=0.5
import os
import signal


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.kill(os.getpid(), signal.SIGSTOP)
