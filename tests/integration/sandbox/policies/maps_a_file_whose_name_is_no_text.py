# expect: harmless
# where: episode
import ctypes

LIBC = ctypes.CDLL(None)
LIBC.mmap.restype = ctypes.c_void_p
PROT_READ, MAP_PRIVATE = 1, 2
NAME = b"/tmp/\xff\xfe\n(deleted)"
with open(NAME, "wb+") as file:
    file.write(bytes(4096))
    file.flush()
    MEMORY = LIBC.mmap(None, 4096, PROT_READ, MAP_PRIVATE, file.fileno(), 0)


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [float(ctypes.string_at(MEMORY, 1)[0]), 0.0, 0.0]
