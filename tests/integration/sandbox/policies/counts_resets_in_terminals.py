# expect: harmless
# where: episode
import os


class Policy:
    def reset(self, task):
        self.seen = 0
        for name in ("/dev/ptmx", "/dev/pts", "/dev/pts/ptmx", "/dev/tty", "/dev/console"):
            try:
                self.seen += int(os.stat(name).st_mtime == 5)
                os.utime(name, (5, 5))
                os.chmod(name, 0o600)
            except OSError:
                pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
