# expect: harmless
# where: episode
import os
import socket


def reached(attempt):
    try:
        return 1.0 if attempt() is not False else 0.0
    except (OSError, ImportError):
        return 0.0


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = [
            reached(lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM)),
            reached(lambda: socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)),
            reached(lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)),
            reached(lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW)),
            reached(lambda: socket.socket(40, socket.SOCK_STREAM)),
            reached(lambda: socket.create_connection(("127.0.0.1", 5432), 1)),
            reached(lambda: socket.getaddrinfo("example.org", 80)),
            reached(lambda: socket.socket(socket.AF_UNIX).connect("/run/dbus/system_bus_socket")),
            reached(lambda: socket.socket(socket.AF_UNIX).connect(chr(0) + "/tmp/.X11-unix/X0")),
        ]
        return [sum(found), 0.0, 0.0]
