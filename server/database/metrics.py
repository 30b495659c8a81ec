"""What a server or worker process counts; `totals` adds it to the database for everybody to read.

Names and units follow Prometheus' conventions.
"""

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from prometheus_client import CollectorRegistry, Counter, Histogram
from sqlalchemy import select, text
from sqlalchemy.orm import Session

from .engine import Database
from .models import MetricTotal


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


_ADD = text("""
    INSERT INTO metric_totals (name, labels, value)
    SELECT * FROM unnest(CAST(:names AS text[]), CAST(:labels AS text[]), CAST(:values AS double precision[]))
    ON CONFLICT (name, labels) DO UPDATE SET value = metric_totals.value + excluded.value
""")
"""One text for any number of rows: written for each number, it took several times as long as its execution."""


@dataclass(frozen=True, order=True)
class SeriesKey:
    """A sample's name (`vitac_episodes_total`) and its labels as JSON with sorted keys."""

    name: str
    labels: str = "{}"

    def label_values(self) -> dict[str, str]:
        """Return the labels."""
        values: dict[str, str] = json.loads(self.labels)
        return values


class TotalsWriter:
    """Adds to the totals what the instruments of this process have counted since it last did so."""

    def __init__(self, instruments: Instruments) -> None:
        self._instruments = instruments
        self._written: Mapping[SeriesKey, float] = {}
        self._lock = threading.Lock()

    def write(self, database: Database) -> None:
        """Write in a transaction of its own.

        Raises:
            DBAPIError: the database is unavailable; what was counted is written the next time.
        """
        with self._lock:
            counted = list_samples(self._instruments)
            added = {key: value - self._written.get(key, 0.0) for key, value in counted.items()}
            with database.transaction() as session:
                # New series also at zero: of a histogram, all buckets have to be there from the start.
                add(session, {key: value for key, value in added.items() if value or key not in self._written})
            self._written = counted


def list_samples(instruments: Instruments) -> dict[SeriesKey, float]:
    """Return the current samples without the times at which they were created."""
    return {
        SeriesKey(sample.name, json.dumps(sample.labels, sort_keys=True)): sample.value
        for family in instruments.registry.collect()
        for sample in family.samples
        if not sample.name.endswith("_created")
    }


def add(session: Session, values: Mapping[SeriesKey, float]) -> None:
    """Add to the totals."""
    if not values:
        return
    # All processes write the same few rows: locked in one order and not held while the disk writes. A crash of the
    # database may cost the last second's counts.
    session.execute(text("SET LOCAL synchronous_commit = off"))
    keys = sorted(values)
    columns = {"names": [key.name for key in keys], "labels": [key.labels for key in keys]}
    session.execute(_ADD, {**columns, "values": [values[key] for key in keys]})


def totals(session: Session) -> dict[SeriesKey, float]:
    """Return the totals of all processes."""
    rows = session.execute(select(MetricTotal.name, MetricTotal.labels, MetricTotal.value))
    return {SeriesKey(name, labels): value for name, labels, value in rows}
