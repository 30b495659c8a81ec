"""Sums up for people what all processes have counted (`server.metrics`)."""

from collections.abc import Iterator, Mapping

from ..metrics.totals import SeriesKey
from ..views.operations import CountsView

SHARE = 0.95


def make_counts_view(totals: Mapping[SeriesKey, float]) -> CountsView:
    """Return the sums; what nobody has counted yet is zero."""
    requests = "vitac_request_seconds"
    failed = [
        value
        for key, value in totals.items()
        if key.name == f"{requests}_count" and key.label_values()["status"] == "5xx"
    ]
    return CountsView(
        episodes=_sum(totals, "vitac_episodes_total"),
        shards_finished=_sum(totals, "vitac_shards_finished_total"),
        shard_retries=_sum(totals, "vitac_shard_retries_total"),
        shards_given_up=_sum(totals, "vitac_shards_given_up_total"),
        leases_lost=_sum(totals, "vitac_leases_lost_total"),
        requests=_sum(totals, f"{requests}_count"),
        requests_failed=int(sum(failed)),
        requests_within_s=estimate_bound(totals, requests),
        claims_within_s=estimate_bound(totals, "vitac_claim_seconds"),
        shard_waits_within_s=estimate_bound(totals, "vitac_shard_wait_seconds"),
    )


def estimate_bound(totals: Mapping[SeriesKey, float], histogram: str) -> float | None:
    """Return the smallest bound of a bucket [s] that holds `SHARE` of all observations.

    None without observations; infinite if they took longer than the last bound.
    """
    buckets: dict[float, float] = {}
    for bound, count in _buckets(totals, f"{histogram}_bucket"):
        buckets[bound] = buckets.get(bound, 0.0) + count
    observed = buckets.get(float("inf"), 0.0)
    if not observed:
        return None
    return min(bound for bound, count in buckets.items() if count >= SHARE * observed)


def _buckets(totals: Mapping[SeriesKey, float], name: str) -> Iterator[tuple[float, float]]:
    for key, value in totals.items():
        if key.name == name:
            yield float(key.label_values()["le"]), value


def _sum(totals: Mapping[SeriesKey, float], name: str) -> int:
    return int(sum(value for key, value in totals.items() if key.name == name))
