# expect: protocol_violation
# where: episode
import os
import socket
import time

from channel_tools import channel, frame, seq


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        sock = socket.socket(fileno=os.dup(channel()))
        descriptor = os.open("/dev/null", os.O_RDONLY)
        socket.send_fds(sock, [frame(seq())], [descriptor])
        time.sleep(60)
