# expect: harmless
# where: episode
import os
import socket
import time


def serve():
    os.setsid()
    server = socket.socket(socket.AF_UNIX)
    server.bind("\0counter")
    server.listen()
    while True:
        server.accept()


class Policy:
    def reset(self, task):
        with socket.socket(socket.AF_UNIX) as client:
            try:
                client.connect("\0counter")
                self.seen = 1
            except OSError:
                self.seen = 0
                if os.fork() == 0:
                    serve()
                time.sleep(0.05)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
