# expect: harmless
# where: episode
import os

DEVICES = ["/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom"]


def times(device):
    return os.stat(device).st_atime_ns, os.stat(device).st_mtime_ns


class Policy:
    def reset(self, task):
        self.seen = 0
        for device in DEVICES:
            before = times(device)
            with open(device, "rb") as file:
                file.read(1)
            descriptor = os.open(device, os.O_WRONLY)
            os.utime(descriptor)
            try:
                os.write(descriptor, b"x")
            except OSError:
                pass
            os.close(descriptor)
            os.utime(device)
            self.seen += times(device) != before

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
