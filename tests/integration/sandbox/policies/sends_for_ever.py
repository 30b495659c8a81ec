# expect: protocol_violation
# where: episode
import os

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            os.write(channel(), bytes(65536))
