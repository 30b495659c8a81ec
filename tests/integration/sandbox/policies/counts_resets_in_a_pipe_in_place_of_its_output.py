# expect: shared_state
# where: load
import os

read, write = os.pipe()
os.dup2(write, 1)
os.dup2(read, 2)
os.close(read)
os.close(write)


class Policy:
    def reset(self, task):
        pass
