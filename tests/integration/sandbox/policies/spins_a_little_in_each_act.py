# expect: cpu_time
# where: episode
# limits: episode_cpu_s=0.4
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        end = time.process_time() + 0.2
        while time.process_time() < end:
            pass
        return [0.0, 0.0, 0.0]
