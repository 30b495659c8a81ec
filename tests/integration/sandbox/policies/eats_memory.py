# expect: out_of_memory
# where: episode
# limits: memory_bytes=300_000_000
import os


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        kept = [bytearray(os.urandom(1 << 20)) * 64 for _ in range(1000)]
