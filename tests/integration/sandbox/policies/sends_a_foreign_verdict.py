# expect: protocol_violation
# where: episode
import os
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), frame(seq(), "failed", [], b"", code="sandbox_failed", message="not my fault"))
        time.sleep(60)
