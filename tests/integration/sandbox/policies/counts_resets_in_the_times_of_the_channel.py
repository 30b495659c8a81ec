# expect: harmless
# where: episode
import os
import stat


def sockets():
    for number in range(16):
        try:
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                yield number
        except OSError:
            pass


def times():
    return [(os.fstat(number).st_atime_ns, os.fstat(number).st_mtime_ns) for number in sockets()]


class Policy:
    def reset(self, task):
        """The channel is the same socket in every episode; a policy may try to set its times and read them later."""
        self.seen = int(times() != [(0, 0)] * len(list(sockets())))
        for number in sockets():
            for change in (lambda it: os.utime(it, ns=(1, 1)), os.utime, lambda it: os.utime(f"/proc/self/fd/{it}")):
                try:
                    change(number)
                except OSError:
                    pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
