"""Submissions of different teams, one after the other in one process; no counter shows what the first one did."""

from pathlib import Path

import numpy as np
from submissions import submission_folder
from vitac.evaluator.agent.session import PolicySession

OBSERVATION = {"x": np.zeros(1, dtype=np.float32)}
REFUSED = {
    "pidfd_open": (434, 1, 0), "pipe2": (293, 0, 0), "socket": (41, 1, 1, 0), "socketpair": (53, 1, 1, 0, 0),
    "statx": (332, -100, 0, 0, 0, 0), "sysinfo": (99, 0), "getrusage": (98, 0, 0), "memfd_create": (319, 0, 0),
    "shmget": (29, 0, 4096, 0o1777), "semget": (64, 0, 1, 0o1777), "msgget": (68, 0, 0o1777),
    "mq_open": (240, 0, 0o102, 0o600, 0), "add_key": (248, 0, 0, 0, 0, -3), "io_uring_setup": (425, 8, 0),
    "flock": (73, 0, 1), "inotify_init1": (294, 0), "statfs": (137, 0, 0), "mincore": (27, 0, 0, 0), "sync": (162,),
    "readahead": (187, 0, 0, 0), "fadvise64": (221, 0, 0, 0, 4), "fanotify_init": (300, 0, 0), "quotactl": (179, 0, 0),
    "name_to_handle_at": (303, -100, 0, 0, 0, 0), "perf_event_open": (298, 0, 0, -1, -1, 0),
}  # fmt: skip
"""Calls that count for the whole machine, or number what they make by such a counter."""
POLICY = f"""
import ctypes, errno, os, threading

LIBC = ctypes.CDLL(None, use_errno=True)
REFUSED = {REFUSED}
TIMES = TIMES_OF_THIS_TEAM


def child():
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)
    return pid


def thread():
    found = []
    one = threading.Thread(target=lambda: found.append(threading.get_native_id()))
    one.start()
    one.join()
    return found[0]


def number_of_file(folder):
    with open(folder + "/count", "w") as file:
        number = os.fstat(file.fileno()).st_ino
    os.remove(folder + "/count")
    return number


def number_of_pipe():
    ends = os.pipe()
    number = os.fstat(ends[0]).st_ino
    for end in ends:
        os.close(end)
    return number


def timer():
    made = ctypes.c_int(-1)
    assert LIBC.syscall(222, 0, None, ctypes.byref(made)) == 0
    return made.value


def number_of_event():
    made = LIBC.eventfd(0, 0)
    number = os.fstat(made).st_ino
    os.close(made)
    return number


def is_answered(call):
    return LIBC.syscall(*map(ctypes.c_long, call)) >= 0 or ctypes.get_errno() != errno.ENOSYS


def read():
    counters = [os.getpid(), os.getppid(), os.getsid(0), child(), thread(), number_of_file("/tmp")]
    counters += [number_of_file("/dev/shm"), number_of_pipe(), timer(), number_of_event()]
    counters += [os.path.exists("/proc/stat"), os.path.exists("/sys/kernel")]
    return counters + [is_answered(call) for call in REFUSED.values()]


class Policy:
    def reset(self, task):
        self.counters = [read() for _ in range(TIMES)][0]

    def act(self, observation):
        return self.counters
"""
N_COUNTERS = 12 + len(REFUSED)


def make(folder: Path, times: int) -> Path:
    return submission_folder(folder, {"policy.py": POLICY.replace("TIMES_OF_THIS_TEAM", str(times))})


def read_counters(folder: Path) -> list[list[float]]:
    with PolicySession(folder) as session:
        found = []
        for _ in range(2):
            with session.episode(task="t", action_shape=(N_COUNTERS,)) as policy:
                found.append(policy.act(OBSERVATION).tolist())
        return found


def test_counters_show_nothing_of_another_teams_submission(tmp_path: Path) -> None:
    one, other = make(tmp_path / "one", times=1), make(tmp_path / "other", times=20)
    first = read_counters(one)
    advanced = read_counters(other)
    assert read_counters(one) == first == advanced
    assert first[0] == first[1]
    assert first[0][11:] == [0] * (N_COUNTERS - 11), dict(zip(REFUSED, first[0][13:], strict=True))
