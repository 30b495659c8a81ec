# expect: harmless
# where: episode
import os
import socket
import stat


class Policy:
    def reset(self, task):
        # Reads what an earlier episode left unread; none is to be there before the first observation.
        self.seen = 0
        for descriptor in range(3, 64):
            try:
                if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                    with socket.socket(fileno=os.dup(descriptor)) as channel:
                        self.seen = len(channel.recv(100, socket.MSG_DONTWAIT | socket.MSG_PEEK))
            except OSError:
                pass

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
