# expect: harmless
# where: episode
import os
import socket

SO_COOKIE, SO_PEERPIDFD = 57, 77


class Policy:
    def reset(self, task):
        self.seen = 0
        ours, _ = socket.socketpair()
        for option, size in ((SO_COOKIE, 8), (SO_PEERPIDFD, 4)):
            try:
                value = int.from_bytes(ours.getsockopt(socket.SOL_SOCKET, option, size), "little")
            except OSError:
                continue
            self.seen += value if option == SO_COOKIE else os.fstat(value).st_ino

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
