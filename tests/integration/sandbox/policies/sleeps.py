# expect: wall_time
# where: episode
# limits: action_wall_s=0.5
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        time.sleep(60)
