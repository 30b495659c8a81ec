"""Works on items in several processes, here or on a Ray cluster, and gives the results in the order of the items.

The results do not depend on how many processes there are. One that is lost is replaced, and its items are worked on
again.
"""

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from itertools import islice
from multiprocessing import active_children, get_context
from typing import Any, TypeVar

from vitac.envs.extras import require_extra
from vitac.errors import VitacError
from vitac.evaluator.parent_death import end_with_parent
from vitac.evaluator.version import evaluator_hash, platform_class, sources_hash

T = TypeVar("T")
R = TypeVar("R")

_WORK: Callable[[Any], Any]
"""What the processes of a pool do."""
_ON_RAY: dict[str, Callable[[Any], Any]] = {}
"""What this process of a cluster does, by the number of the collection."""
_MOST_LOST = 3
"""Number of times that a process may end in the same item."""
_AHEAD = 2
"""Items for each process that are worked on ahead."""
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ProcessesLost(VitacError):
    """Processes ended again and again while they worked on one item; give them more memory, or start fewer."""


class ClusterDiffers(VitacError):
    """A machine of the cluster has other sources or another platform; install the same package there."""


def map_in_order(
    work: Callable[[T], R], items: Iterable[T], processes: int = 1, *, ray: str | None = None
) -> Iterator[R]:
    """Yield the result for each item. Items may have no end: at most two for each process are worked on ahead.

    Args:
        work: what is done with an item; on Ray it is pickled.
        items: in order.
        processes: of this machine.
        ray: address of a Ray cluster whose processes work instead.

    Raises:
        ProcessesLost: a process ended several times in one item.
        ExtraMissing: an address is given and Ray is not installed.
        ClusterDiffers: a machine of the cluster would give other results.
    """
    if ray is not None:
        yield from _map_on_ray(work, items, ray)
    elif processes == 1:
        yield from map(work, items)
    else:
        yield from _map_here(work, items, processes)


def _map_here(work: Callable[[T], R], items: Iterable[T], processes: int) -> Iterator[R]:
    global _WORK
    _WORK = work  # forked: what is loaded here is loaded there
    waiting, others = iter(items), set(active_children())
    pool, lost = _new_pool(processes), 0
    running: deque[Future[R]] = deque()
    at_work = deque(islice(waiting, _AHEAD * processes))
    try:
        while at_work:
            try:
                running.extend(pool.submit(_work, item) for item in islice(at_work, len(running), None))
                result = running[0].result()
            except BrokenProcessPool as broken:
                lost += 1
                if lost == _MOST_LOST:
                    raise ProcessesLost(
                        f"A process ended {lost} times while it worked on {at_work[0]!r:.200} or the items after it; "
                        "give it more memory or start fewer processes."
                    ) from broken
                pool.shutdown(wait=False)
                pool = _new_pool(processes)
                running.clear()
                continue
            lost = 0
            at_work.popleft()
            running.popleft()
            at_work.extend(islice(waiting, 1))
            yield result
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(active_children()) - others:
            process.terminate()


def _new_pool(processes: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(processes, mp_context=get_context("fork"), initializer=_begin, initargs=(os.getpid(),))


def _begin(parent: int) -> None:
    """Begin a process of a pool, which ends with its parent and by the same signals."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent(parent)


def _work(item: Any) -> Any:
    return _WORK(item)


def _map_on_ray(work: Callable[[T], R], items: Iterable[T], address: str) -> Iterator[R]:
    require_extra("ray", "ray", user="--ray")
    import ray

    ray.init(address=address, runtime_env={"env_vars": _ONE_THREAD}, log_to_driver=False, logging_level="error")
    try:
        # Tasks whose process or machine is lost are played again, without end.
        call = ray.remote(num_cpus=1, max_retries=-1)(_work_on_ray)
        shared, number, sources = [ray.put(work)], os.urandom(8).hex(), _sources()
        waiting, ahead = iter(items), _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        running = deque(call.remote(number, shared, sources, item) for item in islice(waiting, ahead))
        while running:
            yield ray.get(running.popleft())
            running.extend(call.remote(number, shared, sources, item) for item in islice(waiting, 1))
    finally:
        ray.shutdown()


def _work_on_ray(number: str, shared: list[Any], sources: tuple[str, ...], item: Any) -> Any:
    """Work on an item in a process of the cluster, which gets the work once."""
    if number not in _ON_RAY:
        import ray

        if _sources() != sources:
            raise ClusterDiffers(
                "A machine of the cluster has other sources of evaluator and training, or another platform, than this "
                "one; install the same package on all."
            )
        _ON_RAY.clear()
        _ON_RAY[number] = ray.get(shared[0])
    return _ON_RAY[number](item)


@cache
def _sources() -> tuple[str, ...]:
    """Return what decides the bytes of a result."""
    return evaluator_hash(), sources_hash("vitac.training"), platform_class()
