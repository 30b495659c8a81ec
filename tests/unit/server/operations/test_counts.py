from collections.abc import Iterable

import pytest
from vitac.server.database.metrics import Instruments, RetryReason, list_samples
from vitac.server.operations.state import estimate_bound, make_counts_view


def test_counts_of_nothing_are_zero() -> None:
    assert set(make_counts_view({}).model_dump().values()) == {0, None}


def test_counts_add_up_over_labels() -> None:
    instruments = Instruments()
    for task in ("peg-insertion", "lock-opening"):
        instruments.episodes.labels(task).inc(3)
    for reason in RetryReason:
        instruments.shard_retries.labels(reason).inc()
    for status in ("2xx", "2xx", "5xx"):
        instruments.requests_s.labels("GET", "/health", status).observe(0.03)
    counts = make_counts_view(list_samples(instruments))
    assert (counts.episodes, counts.shard_retries) == (6, 3)
    assert (counts.requests, counts.requests_failed, counts.requests_within_s) == (3, 1, 0.05)


@pytest.mark.parametrize(
    ("waits_s", "bound_s"), [([], None), ([0.1] * 95 + [100.0] * 5, 0.2), ([0.1] * 94 + [100.0] * 6, 300.0),
                             ([10_000.0], float("inf"))],
)  # fmt: skip
def test_bound_holds_the_share_of_all_observations(waits_s: Iterable[float], bound_s: float | None) -> None:
    instruments = Instruments()
    for wait_s in waits_s:
        instruments.shard_wait_s.observe(wait_s)
    assert estimate_bound(list_samples(instruments), "vitac_shard_wait_seconds") == bound_s
