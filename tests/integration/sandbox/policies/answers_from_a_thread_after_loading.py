# expect: harmless
# where: episode
import threading
import time


class Policy:
    def __init__(self):
        self.ready = threading.Event()
        threading.Thread(target=self.ready.wait, daemon=True).start()

    def reset(self, task):
        pass

    def act(self, observation):
        return [0.0, 0.0, 0.0]
