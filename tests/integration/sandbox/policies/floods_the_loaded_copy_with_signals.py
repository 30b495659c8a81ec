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
                for number in (signal.SIGCONT, signal.SIGSTOP, signal.SIGWINCH):
                    try:
                        os.kill(pid, number)
                    except OSError:
                        pass


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
