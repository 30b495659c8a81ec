# expect: harmless
# where: episode
import threading
import time

TICKS = [0]


def tick():
    while True:
        TICKS[0] += 1
        time.sleep(0.001)


threading.Thread(target=tick, daemon=True).start()
time.sleep(0.02)


class Policy:
    def __init__(self):
        self.first = None

    def reset(self, task):
        before = TICKS[0]
        time.sleep(0.02)
        self.seen = TICKS[0] - before

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
