# expect: protocol_violation
# where: episode
# limits: action_wall_s=2
import os
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        if os.fork() == 0:
            os.write(channel(), frame(seq()))
        time.sleep(60)
