# expect: cpu_time
# where: episode
# limits: action_cpu_s=0.3
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        if os.fork() == 0:
            while True:
                pass
        os.wait()
