# expect: harmless
# where: episode
import ctypes

LIBC = ctypes.CDLL(None, use_errno=True)
CLOCK = ctypes.c_long((~1 << 3) | 2)
CLOCK_GETRES, CLOCK_NANOSLEEP, TIMER_CREATE, TIMER_SETTIME, TIMER_GETTIME = 229, 230, 222, 223, 224
ABSOLUTE = 1
LATER_S = 1_000_000


def seen_by_timer():
    timer, value = ctypes.c_int(), (ctypes.c_long * 4)(0, 0, LATER_S, 0)
    if LIBC.syscall(TIMER_CREATE, CLOCK, None, ctypes.byref(timer)) < 0:
        return 0.0
    LIBC.syscall(TIMER_SETTIME, timer, ABSOLUTE, value, None)
    LIBC.syscall(TIMER_GETTIME, timer, value)
    return LATER_S - value[2] - value[3] / 1e9


def seen_by_sleeping():
    return float(LIBC.syscall(CLOCK_NANOSLEEP, CLOCK, ABSOLUTE, (ctypes.c_long * 2)(0, 1), None) == 0)


def seen_by_resolution():
    return float(LIBC.syscall(CLOCK_GETRES, CLOCK, (ctypes.c_long * 2)()) == 0)


class Policy:
    def reset(self, task):
        self.seen = [seen_by_timer(), seen_by_sleeping(), seen_by_resolution()]

    def act(self, observation):
        return self.seen
