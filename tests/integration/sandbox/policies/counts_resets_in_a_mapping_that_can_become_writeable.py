# expect: shared_state
# where: load
import mmap
import os


class Policy:
    def __init__(self):
        file = os.open("/dev/shm/memory", os.O_RDWR | os.O_CREAT)
        os.ftruncate(file, 4096)
        self.memory = mmap.mmap(file, 4096, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        os.close(file)

    def reset(self, task):
        self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
