# expect: protocol_violation
# where: episode
import os

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), frame(seq()))
        return [0.0, 0.0, 0.0]
