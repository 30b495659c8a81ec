# expect: wall_time
# where: episode
# limits: action_wall_s=0.5
import os
import time

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.close(channel())
        time.sleep(60)
