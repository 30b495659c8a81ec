import pytest
from vitac.server.api.limiter import ConcurrencyLimiter, WindowLimiter
from vitac.server.errors import ProblemCode, ServiceError


def test_window_lets_so_many_through_per_key_and_opens_again() -> None:
    now = [0.0]
    limiter = WindowLimiter(limit=2, window_s=10.0, clock=lambda: now[0])
    limiter.note("a", "things")
    now[0] = 4.0
    limiter.note("a", "things")
    limiter.note("b", "things")
    with pytest.raises(ServiceError) as refused:
        limiter.note("a", "things")
    assert (refused.value.code, refused.value.extras["retry_after_s"]) == (ProblemCode.TOO_MANY_REQUESTS, 6)
    now[0] = 10.0
    limiter.note("a", "things")


def test_window_forgets_keys_that_fell_silent() -> None:
    now = [0.0]
    limiter = WindowLimiter(limit=1, window_s=1.0, clock=lambda: now[0])
    for number in range(100):
        limiter.note(str(number), "things")
    now[0] = 2.0
    limiter.note("new", "things")
    assert len(limiter._events) == 1


def test_concurrency_counts_what_runs_and_frees_it_after_errors() -> None:
    limiter = ConcurrencyLimiter(1)
    with (
        limiter.one("a", "things"),
        limiter.one("b", "things"),
        pytest.raises(ServiceError),
        limiter.one("a", "things"),
    ):
        pass
    with pytest.raises(ZeroDivisionError), limiter.one("a", "things"):
        _ = 1 / 0
    with limiter.one("a", "things"):
        pass
