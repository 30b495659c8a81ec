# expect: harmless
# where: episode
import ctypes
import multiprocessing
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import shared_memory

import numpy as np


def square(value):
    return value * value


def check(name, is_right):
    if not is_right:
        raise AssertionError(name)


class Policy:
    """What honest policies do with the system, as far as the documents promise it."""

    def __init__(self):
        self.table = np.load(self.saved()) if os.path.exists(self.saved()) else np.arange(9.0).reshape(3, 3)

    @staticmethod
    def saved():
        return os.path.join(os.path.dirname(__file__), "weights.npy")

    def reset(self, task):
        check("linear algebra", np.allclose(np.linalg.inv(self.table + np.eye(3) * 9) @ (self.table + np.eye(3) * 9), np.eye(3)))
        check("random", np.random.default_rng().random() < 1)
        with ThreadPoolExecutor(4) as threads:
            check("threads", list(threads.map(square, range(8))) == [n * n for n in range(8)])
        done = subprocess.run([sys.executable, "-c", "print(6 * 7)"], capture_output=True, text=True, timeout=8)
        check("subprocess", done.stdout == "42\n")
        check("shell", subprocess.check_output("ls /; touch /tmp/a; cp -p /tmp/a /tmp/b", shell=True))
        check("standard input", subprocess.run(["cat"], input=b"x", stdout=subprocess.PIPE).stdout == b"x")

    def act(self, observation):
        with multiprocessing.get_context("fork").Pool(2) as pool:
            check("pool", pool.map(square, [1, 2]) == [1, 4])
        queue = multiprocessing.SimpleQueue()
        worker = multiprocessing.Process(target=queue.put, args=(7,))
        worker.start()
        check("queue", queue.get() == 7)
        worker.join()
        block = shared_memory.SharedMemory(create=True, size=4096)
        block.close()
        block.unlink()
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as nameless:
            nameless.write(b"x")
            path = os.path.join(folder, "a.npy")
            np.save(path, self.table)
            shutil.copy2(path, path + "2")
            check("mapping", np.load(path + "2", mmap_mode="r")[2, 2] == 8)
            check("database", sqlite3.connect(os.path.join(folder, "d")).execute("select 1").fetchone() == (1,))
        signal.setitimer(signal.ITIMER_REAL, 5)
        signal.setitimer(signal.ITIMER_REAL, 0)
        timer = threading.Timer(0.001, int)
        timer.start()
        timer.join()
        time.sleep(0.001)
        check("clocks", time.process_time() > 0 and time.thread_time() >= 0)
        check("affinity", os.sched_getaffinity(0))
        check("library", ctypes.CDLL(None).getpid() == os.getpid())
        return [0.0, 0.0, 0.0]
