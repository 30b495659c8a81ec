# expect: protocol_violation
# where: episode
import os
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), frame(seq(), success=True))
        time.sleep(60)
