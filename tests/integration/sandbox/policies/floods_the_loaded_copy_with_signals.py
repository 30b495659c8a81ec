# expect: harmless
# where: episode
import os
import signal
import threading

# While the evaluator freezes the loaded copy, another process sends it signals without end.
PARENT = os.getpid()
if os.fork() == 0:
    while True:
        for pid in range(2, 10):
            if pid != os.getpid():
                try:
                    os.kill(pid, signal.SIGCONT)
                    os.kill(pid, signal.SIGWINCH)
                except OSError:
                    pass


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
