# expect: harmless
# where: episode
import ctypes

PR_SET_DUMPABLE = 4
LIBC = ctypes.CDLL(None)
LIBC.prctl(PR_SET_DUMPABLE, 0)


class Policy:
    def reset(self, task):
        LIBC.prctl(PR_SET_DUMPABLE, 0)

    def act(self, observation):
        return [0.0, 0.0, 0.0]
