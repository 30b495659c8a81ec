# expect: harmless
# where: episode
import os
import socket

# A helper process answers over a socket whose name outlives this process.
if os.fork() == 0:
    server = socket.socket(socket.AF_UNIX)
    server.bind("\0counter")
    server.listen()
    count = 0
    while True:
        connection, _ = server.accept()
        connection.send(bytes([count]))
        count += 1


class Policy:
    def reset(self, task):
        try:
            with socket.socket(socket.AF_UNIX) as client:
                client.connect("\0counter")
                self.seen = client.recv(1)[0]
        except OSError:
            self.seen = 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
