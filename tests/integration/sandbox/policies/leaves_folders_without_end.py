# expect: shared_state
# where: load
import os

os.chdir("/tmp")
for _ in range(2000):
    os.mkdir("deeper")
    os.chdir("deeper")


class Policy:
    def reset(self, task):
        pass
