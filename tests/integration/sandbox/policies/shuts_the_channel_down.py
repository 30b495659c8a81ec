# expect: harmless
# where: episode
import os
import socket

from channel_tools import channel


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        sock = socket.socket(fileno=os.dup(channel()))
        try:
            sock.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        return [0.0, 0.0, 0.0]
