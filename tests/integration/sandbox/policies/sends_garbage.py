# expect: protocol_violation
# where: episode
import os
import time

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), os.urandom(4096))
        time.sleep(60)
