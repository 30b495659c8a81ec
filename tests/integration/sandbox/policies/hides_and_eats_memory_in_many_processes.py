# expect: out_of_memory
# where: episode
# limits: memory_bytes=300_000_000
import ctypes
import os
import time

PR_SET_DUMPABLE = 4


class Policy:
    def reset(self, task):
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 0)

    def act(self, observation):
        for _ in range(20):
            if os.fork() == 0:
                kept = bytearray(os.urandom(1 << 20)) * 40
                time.sleep(60)
        time.sleep(60)
