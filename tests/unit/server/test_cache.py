from concurrent.futures import ThreadPoolExecutor

import pytest
from vitac.server.cache import Cache


def test_makes_a_value_once_and_drops_what_was_not_asked_for_longest() -> None:
    cache: Cache[str, int] = Cache(at_most=2)
    made: list[str] = []

    def ask(key: str) -> int:
        return cache.get(key, lambda: made.append(key) or len(made))  # type: ignore[func-returns-value]

    assert [ask(key) for key in ("a", "b", "a", "c", "a")] == [1, 2, 1, 3, 1]
    assert ask("b") == 4
    assert made == ["a", "b", "c", "b"]


def test_what_was_made_with_others_is_kept_and_found() -> None:
    cache: Cache[str, int] = Cache(at_most=2)
    for key, value in (("a", 1), ("b", 2)):
        cache.keep(key, value)
    assert cache.find("a") == 1
    cache.keep("c", 3)
    assert [cache.find(key) for key in ("a", "b", "c")] == [1, None, 3]
    assert cache.get("c", lambda: 4) == 3


def test_a_value_that_could_not_be_made_is_asked_for_again() -> None:
    cache: Cache[str, int] = Cache(at_most=2)
    with pytest.raises(ZeroDivisionError):
        cache.get("a", lambda: 1 // 0)
    assert cache.get("a", lambda: 2) == 2


def test_many_threads_may_ask_at_once() -> None:
    cache: Cache[int, int] = Cache(at_most=3)
    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(lambda n: cache.get(n % 5, lambda: n % 5), range(2000)))
    assert found == [n % 5 for n in range(2000)]
