# expect: too_many_processes
# where: episode
import threading
import time


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        while True:
            threading.Thread(target=time.sleep, args=(60,)).start()
