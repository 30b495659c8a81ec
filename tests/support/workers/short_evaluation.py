"""Shortens evaluations to a few episodes in this process, so that tests with the real simulation stay short.

Also the program of a worker process for such tests: `python short_evaluation.py` runs a worker until SIGTERM. It does
not try its sandbox out first, which takes two seconds; `tests/unit/worker/test_isolation` does.
"""

import subprocess
from collections.abc import Callable, Sequence

from vitac.cli.service.web_server import no_collections

with no_collections():  # as in `vitac worker`
    from vitac.evaluator.tracks import Task
    from vitac.evaluator.tracks.definition import ShardEpisodes, cut
    from vitac.server.evaluations import lifecycle

EPISODES = (1, 2, 3, 4, 31, 32, 33, 34)
"""Four of each of the first two shards."""


StartWorker = Callable[[], "subprocess.Popen[bytes]"]
"""Starts a worker process on the service under test."""


def short_cut(task: Task) -> Sequence[ShardEpisodes]:
    return cut(task, EPISODES)


def shorten() -> None:
    setattr(lifecycle, "cut", short_cut)  # noqa: B010 - a name that the module imports


if __name__ == "__main__":
    with no_collections():
        from vitac.server.settings import load_settings
        from vitac.worker.capabilities import IsolationReport
        from vitac.worker.main import run

    shorten()
    run(load_settings(), probe=lambda: IsolationReport(level="not tried out", problems=()))
