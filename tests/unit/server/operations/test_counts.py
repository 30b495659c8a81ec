from collections.abc import Iterable

import pytest
from vitac.server.metrics.instruments import Instruments, RetryReason
from vitac.server.metrics.totals import samples_of
from vitac.server.operations.counts import bound_of, counts_of


def test_counts_of_nothing_are_zero() -> None:
    assert set(counts_of({}).model_dump().values()) == {0, None}


def test_counts_add_up_over_labels() -> None:
    instruments = Instruments()
    for task in ("peg-insertion", "lock-opening"):
        instruments.episodes.labels(task).inc(3)
    for reason in RetryReason:
        instruments.shard_retries.labels(reason).inc()
    for status in ("2xx", "2xx", "5xx"):
        instruments.requests_s.labels("GET", "/health", status).observe(0.03)
    counts = counts_of(samples_of(instruments))
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
    assert bound_of(samples_of(instruments), "vitac_shard_wait_seconds") == bound_s
