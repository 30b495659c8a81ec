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
        header = b"[" * 30_000
        os.write(channel(), struct.pack("<4sIQ", b"VTC1", len(header), 0) + header)
        time.sleep(60)
