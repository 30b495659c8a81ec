# expect: harmless
# where: episode
import fcntl


class Policy:
    def reset(self, task):
        F_SETPIPE_SZ, F_GETPIPE_SZ = 1031, 1032
        self.seen = fcntl.fcntl(1, F_GETPIPE_SZ) // 65536 - 1
        try:
            fcntl.fcntl(1, F_SETPIPE_SZ, 65536 * 2)
        except OSError:
            pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
