# expect: harmless
# where: episode
import ctypes
import os

LIBC = ctypes.CDLL(None, use_errno=True)
FLAGS = [0x80, 0x20000, 0x2000000, 0x4000000, 0x8000000, 0x10000000, 0x20000000, 0x40000000]


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = 0
        for flag in FLAGS:
            pid = LIBC.syscall(56, ctypes.c_long(flag | 17), None, None, None, None)
            if pid == 0:
                os._exit(0)
            found += pid > 0
        return [float(found), 0.0, 0.0]
