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
            reached(lambda: open("/etc/shadow", "rb").read()),
            reached(lambda: open("/proc/1/environ", "rb").read()),
            reached(lambda: open("/proc/self/environ", "rb").read()),
            reached(lambda: open("/proc/1/mem", "rb").read()),
            reached(lambda: open("/proc/cmdline", "rb").read()),
            reached(lambda: open("/proc/kallsyms", "rb").read()),
            reached(lambda: open("/etc/hostname", "rb").read()),
            reached(lambda: open("/etc/hosts", "rb").read()),
            reached(lambda: open("/var/log/syslog", "rb").read()),
            reached(lambda: open("/root/.bashrc", "rb").read()),
            reached(lambda: open("/sys/kernel/notes", "rb").read()),
            reached(lambda: open("/dev/kmsg", "rb").read()),
            reached(lambda: open("/dev/mem", "rb").read()),
            reached(lambda: open("/dev/sda", "rb").read()),
            reached(lambda: open("/dev/vda", "rb").read()),
            reached(lambda: os.listdir("/root")),
            reached(lambda: os.listdir("/home")),
            reached(lambda: os.listdir("/work")),
            reached(lambda: os.listdir("/var")),
            reached(lambda: os.listdir("/run")),
            reached(lambda: os.listdir("/mnt")),
            reached(lambda: os.listdir("/srv")),
            reached(lambda: os.listdir("/proc")),
            reached(lambda: os.listdir("/sys")),
            reached(lambda: os.listdir("/opt/vitac/packages/0/vitac")),
            reached(lambda: os.listdir("/dev/fd/../cwd/../..")),
            reached(lambda: set(os.listdir("/")) - set("bin dev etc lib lib32 lib64 libx32 opt sbin submission tmp usr".split()) or False),
            reached(lambda: set(os.listdir("/etc")) - {"passwd", "ld.so.cache", "alternatives"} or False),
            reached(lambda: __import__("vitac.evaluator")),
        ]
        return [sum(found), 0.0, 0.0]
