"""Sums of the instruments of all processes, stored in the database: what a process has counted outlives it.

Housekeeping adds what its process has counted since the last time, so any server knows what all workers did.
"""

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from ..db.engine import Database
from ..db.models import MetricTotal
from .instruments import Instruments

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
