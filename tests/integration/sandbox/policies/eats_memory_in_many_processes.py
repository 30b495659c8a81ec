# expect: out_of_memory
# where: episode
# limits: memory_bytes=300_000_000 action_wall_s=5
import os
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        for _ in range(20):
            if os.fork() == 0:
                kept = bytearray(40_000_000)
                for position in range(0, len(kept), 4096):
                    kept[position] = 1
                time.sleep(60)
        time.sleep(60)
