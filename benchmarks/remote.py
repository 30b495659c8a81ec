"""Measures what asking a policy server costs beside its codec, and whether pictures go at 10 env steps a second.

Run it as `python benchmarks/remote.py [--exchanges 300] [--seconds 30]`. The server is a process of its own that
answers each observation with zeros; nothing is simulated. Of many times the best tells of the code, the median of the
machine.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.remote.codec import decode, encode, read_value
from vitac.evaluator.remote.description import RemoteServer
from vitac.evaluator.remote.session import RemotePolicy, RemoteSession

Observation = Mapping[str, NDArray[Any]]
TOUCH: Observation = {
    "marker_flow": np.ones((2, 2, 128, 2), np.float32),
    "relative_motion": np.ones(4, np.float32),
}
_RANDOM = np.random.default_rng(0)
PICTURES: Observation = {
    "rgb": _RANDOM.integers(0, 256, (480, 640, 3), np.uint8),
    "depth": _RANDOM.random((480, 640), np.float32),
    "tactile_left": _RANDOM.integers(0, 256, (240, 320, 3), np.uint8),
    "tactile_right": _RANDOM.integers(0, 256, (240, 320, 3), np.uint8),
}
SERVER = """
import sys
import numpy as np
from vitac.evaluator.remote.codec import decode, encode, read_value
from websockets.sync.server import serve

def answer(connection):
    connection.send(encode({}, binary_keys=True))
    for question in connection:
        observation = decode(question)
        arrays = {name: read_value(value) for name, value in observation.items() if not isinstance(value, str)}
        assert all(array.size for array in arrays.values())
        connection.send(encode({"actions": np.zeros(3)}, binary_keys=True))

with serve(answer, "127.0.0.1", 0, compression=None, max_size=None) as server:
    print(server.socket.getsockname()[1], flush=True)
    server.serve_forever()
"""
PERIOD_S = 0.1


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--exchanges", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=30.0)
    arguments = parser.parse_args()
    with asked() as policy:
        for name, observation in (("touch", TOUCH), ("pictures", PICTURES)):
            whole_s, codec_s = measure_exchange(policy, observation, arguments.exchanges)
            for what, choose in (("best", min), ("median", median)):
                whole_ms, codec_ms = 1e3 * choose(whole_s), 1e3 * choose(codec_s)
                print(
                    f"{name}, {what} of {arguments.exchanges}: {whole_ms:.2f} ms an exchange, codec at both ends ",
                    end="",
                )
                print(f"{codec_ms:.2f} ms, beside it {whole_ms - codec_ms:.2f} ms")
        late, grown_kib, steps = play_in_time(policy, arguments.seconds)
    print(f"pictures at 10 steps/s: {late} of {steps} late, memory grew by {grown_kib} KiB")
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    print(f"load {load} on {os.cpu_count()} cores")


@contextmanager
def asked() -> Iterator[RemotePolicy]:
    """Give a policy that a process of its own answers."""
    with subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True) as process:  # noqa: S603 - our own program
        try:
            assert process.stdout is not None  # noqa: S101 - it is a pipe
            address = f"ws://127.0.0.1:{int(process.stdout.readline())}"
            server = RemoteServer.model_validate({"protocol": "openpi"})
            with RemoteSession(address, server) as session, session.episode(task="t", action_shape=(3,)) as policy:
                yield policy
        finally:
            process.kill()


def measure_exchange(policy: RemotePolicy, observation: Observation, exchanges: int) -> tuple[list[float], list[float]]:
    """Return the times of exchanges, and those of their codec at both ends [s]."""
    whole_s, codec_s = [], []
    for _ in range(exchanges):
        started_s = time.perf_counter()
        policy.act(observation)
        whole_s.append(time.perf_counter() - started_s)
        started_s = time.perf_counter()
        question = decode(encode({**observation, "prompt": "t"}, binary_keys=True))
        for name in observation:
            read_value(question[name])
        read_value(decode(encode({"actions": np.zeros(3)}, binary_keys=True))["actions"])
        codec_s.append(time.perf_counter() - started_s)
    return whole_s, codec_s


def play_in_time(policy: RemotePolicy, seconds: float) -> tuple[int, int, int]:
    """Ask every tenth of a second; return how many answers were late, the growth of memory [KiB], and the steps."""
    steps, late, first_kib = round(seconds / PERIOD_S), 0, 0
    begun_s = time.perf_counter()
    for step in range(steps):
        time.sleep(max(0.0, begun_s + step * PERIOD_S - time.perf_counter()))
        policy.act(PICTURES)
        late += time.perf_counter() > begun_s + (step + 1) * PERIOD_S
        if step == steps // 5:  # from then on nothing is new
            first_kib = resident_kib()
    return late, resident_kib() - first_kib, steps


def resident_kib() -> int:
    """Return the memory of this process [KiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


if __name__ == "__main__":
    main()
