# expect: protocol_violation
# where: episode
import os
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        self.child = 0

    def act(self, observation):
        if self.child:
            time.sleep(0.3)
        self.child = self.child or os.fork()
        if not self.child:
            number = seq()
            time.sleep(0.1)
            os.write(channel(), frame(number))
            time.sleep(60)
        return [0.0, 0.0, 0.0]
