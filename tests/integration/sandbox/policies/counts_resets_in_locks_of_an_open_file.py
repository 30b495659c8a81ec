# expect: harmless
# where: episode
import fcntl
import os
import struct

F_OFD_GETLK, F_OFD_SETLK = 36, 37
LOCK = "hhqqi4x"


class Policy:
    def __init__(self):
        self.file = os.open(__file__, os.O_RDONLY)

    def reset(self, task):
        asked = struct.pack(LOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        with open(__file__) as other:
            answer = fcntl.fcntl(other, F_OFD_GETLK, asked)
        self.seen = int(struct.unpack(LOCK, answer)[0] != fcntl.F_UNLCK)
        fcntl.fcntl(self.file, F_OFD_SETLK, struct.pack(LOCK, fcntl.F_RDLCK, os.SEEK_SET, 0, 1, 0))

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
