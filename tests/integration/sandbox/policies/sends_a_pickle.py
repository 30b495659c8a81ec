# expect: protocol_violation
# where: episode
import os
import pickle
import time

from channel_tools import channel


class Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/unpickled",)


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        os.write(channel(), pickle.dumps(Evil()))
        time.sleep(60)
