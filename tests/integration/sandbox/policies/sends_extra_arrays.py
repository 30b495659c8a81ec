# expect: protocol_violation
# where: episode
import os
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        two = [{"name": name, "dtype": "f4", "shape": [3]} for name in ("action", "more")]
        os.write(channel(), frame(seq(), arrays=two, payload=bytes(24)))
        time.sleep(60)
