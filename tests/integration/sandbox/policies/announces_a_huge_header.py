# expect: protocol_violation
# where: episode
import os
import struct
import time

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), struct.pack("<4sIQ", b"VTC1", 0xFFFFFFFF, 12))
        time.sleep(60)
