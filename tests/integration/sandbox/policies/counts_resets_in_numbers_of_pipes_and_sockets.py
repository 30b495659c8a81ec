# expect: harmless
# where: episode
import ctypes
import os
import socket

from channel_tools import channel

LIBC = ctypes.CDLL(None, use_errno=True)
SO_COOKIE, SO_PEERPIDFD, STATX, MOUNT_NUMBER = 57, 77, 332, 0x1000


def number_of_pipe():
    """The kernel counts all pipes of the machine (on each CPU); a named pipe has a number of its file system."""
    ends = os.pipe()
    number = os.fstat(ends[0]).st_ino
    for end in ends:
        os.close(end)
    return number


AFTER_LOADING = number_of_pipe()


def succeeds(call, *arguments):
    return call(*arguments) == 0


class Policy:
    def reset(self, task):
        self.seen = number_of_pipe() - AFTER_LOADING - 1
        ends, found = (ctypes.c_int * 2)(), ctypes.create_string_buffer(1024)
        self.seen += succeeds(LIBC.pipe, ends) + succeeds(LIBC.socketpair, 1, 1, 0, ends)
        self.seen += succeeds(LIBC.syscall, STATX, -100, b"/tmp", 0, MOUNT_NUMBER, found)
        for option in (SO_COOKIE, SO_PEERPIDFD):
            size = ctypes.byref(ctypes.c_int(8))
            self.seen += succeeds(LIBC.getsockopt, channel(), socket.SOL_SOCKET, option, found, size)

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
