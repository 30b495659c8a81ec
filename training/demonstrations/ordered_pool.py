"""Works on items in several processes and gives the results in the order of the items, however many there are."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")

_WORK: Callable[[Any], Any]
"""What the processes of a pool do."""


def map_in_order(work: Callable[[T], R], items: Iterable[T], processes: int) -> Iterator[R]:
    """Yield the result for each item. Items may have no end: at most two for each process are worked on ahead."""
    if processes == 1:
        yield from map(work, items)
        return
    global _WORK
    _WORK = work  # forked: what is loaded here is loaded there
    with get_context("fork").Pool(processes) as pool:
        waiting = iter(items)
        running = deque(pool.apply_async(_work, (item,)) for item in islice(waiting, 2 * processes))
        while running:
            yield running.popleft().get()
            running.extend(pool.apply_async(_work, (item,)) for item in islice(waiting, 1))


def _work(item: Any) -> Any:
    return _WORK(item)
