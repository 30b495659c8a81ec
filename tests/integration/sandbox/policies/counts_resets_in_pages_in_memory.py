# expect: harmless
# where: episode
import ctypes
import os

LIBC = ctypes.CDLL(None, use_errno=True)


class Policy:
    def reset(self, task):
        """Drop the file's pages, or ask which are there: both would be a memory that all episodes share."""
        file = os.open(__file__, os.O_RDONLY)
        self.seen = 0
        try:
            os.posix_fadvise(file, 0, 0, os.POSIX_FADV_DONTNEED)
            self.seen += 1
        except OSError:
            pass
        try:
            os.preadv(file, [bytearray(1)], 0, os.RWF_NOWAIT)
            self.seen += 1
        except OSError:
            pass
        self.seen += LIBC.mincore(ctypes.c_void_p(id(self) & ~4095), 1, ctypes.create_string_buffer(1)) == 0

    def act(self, observation):
        return [float(self.seen), 0.0, 0.0]
