# expect: harmless
# where: episode
import os
import socket


def reached(attempt):
    try:
        return 1.0 if attempt() is not False else 0.0
    except (OSError, ImportError):
        return 0.0


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = [
            reached(lambda: open("/x", "w")),
            reached(lambda: open("/submission/x", "w")),
            reached(lambda: open("/submission/policy.py", "w")),
            reached(lambda: open("/usr/x", "w")),
            reached(lambda: open("/etc/passwd", "w")),
            reached(lambda: open("/opt/vitac/agent.py", "w")),
            reached(lambda: open("/opt/vitac/x", "w")),
            reached(lambda: open("/dev/x", "w")),
            reached(lambda: open("/opt/vitac/packages/0/x", "w")),
            reached(lambda: os.mkdir("/submission/d")),
            reached(lambda: os.chmod("/submission/policy.py", 0o777)),
            reached(lambda: os.remove("/etc/passwd")),
            reached(lambda: os.mknod("/tmp/null", 0o20666, os.makedev(1, 3))),
        ]
        return [sum(found), 0.0, 0.0]
