# expect: harmless
# where: episode
import os
import time


def serve():
    os.setsid()
    if not os.path.exists("/dev/shm/counter"):
        os.mkfifo("/dev/shm/counter")
    with open("/dev/shm/counter", "rb"):
        time.sleep(60)


class Policy:
    def reset(self, task):
        try:
            os.close(os.open("/dev/shm/counter", os.O_WRONLY | os.O_NONBLOCK))
            self.seen = 1
        except OSError:
            self.seen = 0
            if os.fork() == 0:
                serve()
            time.sleep(0.05)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
