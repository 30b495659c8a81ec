"""What a server or worker process counts; `totals` adds it to the database for everybody to read.

Names and units follow Prometheus' conventions.
"""

from enum import StrEnum

from prometheus_client import CollectorRegistry, Counter, Histogram


class RetryReason(StrEnum):
    """Why a shard was queued again."""

    LEASE_EXPIRED = "lease_expired"  # its worker was lost
    BROKE = "broke"  # the machine could not run it
    HANDED_BACK = "handed_back"  # its worker was stopped


WAIT_BUCKETS_S = (0.05, 0.2, 1.0, 5.0, 20.0, 60.0, 300.0, 1800.0, 7200.0)
CLAIM_BUCKETS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2.0)
REQUEST_BUCKETS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2.0, 10.0)


class Instruments:
    """Counters and histograms of one process, from its start. Thread-safe."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        self.episodes = Counter("vitac_episodes", "Episodes stored by workers.", ["task"], registry=registry)
        self.shards_finished = Counter("vitac_shards_finished", "Shards run to their end.", registry=registry)
        self.shard_retries = Counter("vitac_shard_retries", "Shards queued again.", ["reason"], registry=registry)
        for reason in RetryReason:
            self.shard_retries.labels(reason)
        self.shards_given_up = Counter(
            "vitac_shards_given_up", "Shards lost in all their attempts, each of which fails an evaluation.",
            registry=registry,
        )  # fmt: skip
        self.leases_lost = Counter(
            "vitac_leases_lost", "Shards that a worker had to leave: another one has them or the evaluation was ended.",
            registry=registry,
        )  # fmt: skip
        self.shard_wait_s = Histogram(
            "vitac_shard_wait_seconds", "Time from queueing a shard to its claim.",
            buckets=WAIT_BUCKETS_S, registry=registry,
        )  # fmt: skip
        self.claim_s = Histogram(
            "vitac_claim_seconds", "Time that claiming a shard takes in the database.",
            buckets=CLAIM_BUCKETS_S, registry=registry,
        )  # fmt: skip
        self.requests_s = Histogram(
            "vitac_request_seconds", "Time from a request to the start of its answer; an upload's includes its body.",
            ["method", "route", "status"], buckets=REQUEST_BUCKETS_S, registry=registry,
        )  # fmt: skip
