# expect: out_of_memory
# where: episode
# limits: memory_bytes=120000000 action_cpu_s=20.0 action_wall_s=60.0
import os
import socket
import time


def fill(pair):
    """What is sent and never read lies in the kernel; no process's own memory shows it."""
    for end in pair:
        end.setblocking(False)
        try:
            while True:
                end.send(bytes(16384))
        except BlockingIOError:
            pass


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        for _ in range(8):
            if os.fork() == 0:
                kept = [socket.socketpair() for _ in range(100)]
                for pair in kept:
                    fill(pair)
                time.sleep(60)
        time.sleep(60)
