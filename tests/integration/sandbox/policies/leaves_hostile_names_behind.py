# expect: harmless
# where: episode
import os

# Names and rights that make clearing up hard.
os.mkdir("/tmp/closed")
os.mkdir("/tmp/closed/inner")
open(b"/tmp/closed/inner/\xff\x80", "w").close()
os.symlink("/", "/tmp/closed/inner/root")
os.symlink("/proc/self", "/tmp/link")
os.mkfifo("/tmp/pipe")
os.chmod("/tmp/closed/inner", 0)
os.chmod("/tmp/closed", 0)


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [float(len(os.listdir("/tmp"))), 0.0, 0.0]
