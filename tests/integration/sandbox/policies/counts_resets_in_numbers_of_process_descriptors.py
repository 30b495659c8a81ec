# expect: harmless
# where: episode
import ctypes
import os
import signal

SYSCALL = ctypes.CDLL(None).syscall
CLONE, PIDFD_OPEN, CLONE_PIDFD = 56, 434, 0x1000


class Policy:
    def reset(self, task):
        given = ctypes.c_int(-1)
        child = SYSCALL(CLONE, ctypes.c_ulong(CLONE_PIDFD | signal.SIGCHLD), None, ctypes.byref(given), None, 0)
        if child == 0:
            os._exit(0)
        descriptors = [SYSCALL(PIDFD_OPEN, os.getpid(), 0), given.value]
        self.seen = sum(os.fstat(descriptor).st_ino for descriptor in descriptors if descriptor >= 0)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
