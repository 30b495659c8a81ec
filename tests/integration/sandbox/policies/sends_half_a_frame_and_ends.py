# expect: crashed
# where: episode
import os

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), frame(seq())[:30])
        os._exit(3)
