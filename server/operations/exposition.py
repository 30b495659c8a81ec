"""Writes the state of the service and the totals of all processes in Prometheus' text format, for `/metrics`.

All servers of a service show the same figures, except those named `vitac_server_...` and `process_...`.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.samples import Sample
from sqlalchemy.exc import DBAPIError

from ..database.metrics import Instruments, SeriesKey, list_samples, totals
from ..database.states import WorkerState
from ..queue.workers import Disk, measure_disk
from ..receipts.witnesses import list_witness_views
from ..services import Services
from ..views.operations import OperationsView
from ..views.receipts import WitnessView
from .state import operations

LIMIT_S = 3.0
"""A database that does not answer within this time counts as down: whoever scrapes waits for 10 s."""
KEPT_S = 5.0
"""How long one answer serves all requests: several Prometheus servers cost the database no more than one."""

LOST = "lost"


class Exposition:
    """The answer of one server process to scrapes. Thread-safe."""

    def __init__(self, services: Services, clock: Callable[[], float] = time.monotonic) -> None:
        self._services = services
        self._clock = clock
        self._reader = ThreadPoolExecutor(1, "metrics")
        self._lock = threading.Lock()
        self._made_at = float("-inf")
        self._text = b""

    def text(self) -> bytes:
        """Return all metrics; without the database's where it is unavailable."""
        with self._lock:
            if self._clock() - self._made_at > KEPT_S:
                registry = CollectorRegistry()
                ProcessCollector(registry=registry)
                registry.register(_Families(self._families()))
                self._text = generate_latest(registry)
                self._made_at = self._clock()
            return self._text

    def _families(self) -> list[Metric]:
        disk = measure_disk(self._services.settings.state_dir)
        reading = self._reader.submit(self._read)
        try:
            counted, state, witnesses = reading.result(LIMIT_S)
        except (DBAPIError, TimeoutError):
            reading.cancel()  # unless it hangs: then the next one waits for its thread
            return [_gauge("vitac_database_up", "Whether the database answers.", 0), *server_families(disk)]
        return [
            _gauge("vitac_database_up", "Whether the database answers.", 1),
            *server_families(disk),
            *state_families(state),
            *witness_families(witnesses),
            *total_families(counted),
        ]

    def _read(self) -> tuple[dict[SeriesKey, float], OperationsView, Sequence[WitnessView]]:
        with self._services.database.transaction() as session:
            counted = totals(session)
            return counted, operations(session, self._services.settings, counted), list_witness_views(session)


class _Families:
    """A collector of what was read already."""

    def __init__(self, families: Iterable[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterable[Metric]:
        """Return the families."""
        return self._families


def server_families(disk: Disk) -> Iterator[Metric]:
    """Yield what holds of this server's machine only."""
    yield _gauge("vitac_server_disk_bytes", "Size of the disk with the state directory.", disk.total_bytes)
    yield _gauge("vitac_server_disk_free_bytes", "Free space on the disk with the state directory.", disk.free_bytes)


def state_families(state: OperationsView) -> Iterator[Metric]:
    """Yield gauges of queue, storage and workers."""
    queue, storage = state.queue, state.storage
    shards = {"queued": queue.shards_queued, "running": queue.shards_running}
    yield _gauges("vitac_shards", "Shards that wait or run.", "state", shards)
    evaluations = {"queued": queue.evaluations_queued, "running": queue.evaluations_running}
    yield _gauges("vitac_evaluations", "Evaluations that wait or run.", "state", evaluations)
    yield _gauge("vitac_oldest_shard_seconds", "Age of the oldest queued shard.", queue.oldest_shard_s or 0)
    yield _gauge(
        "vitac_oldest_evaluation_seconds", "Age of the oldest queued evaluation.", queue.oldest_evaluation_s or 0
    )
    yield _gauge("vitac_evaluations_unserved", "Evaluations whose evaluator no worker has.", queue.evaluations_unserved)
    yield _gauge(
        "vitac_shard_idle_seconds", "Longest time since a running shard stored an episode.", queue.shard_idle_s or 0
    )
    yield _gauge("vitac_uploads", "Different uploaded files in the storage.", storage.uploads)
    yield _gauge("vitac_uploads_bytes", "Size of the uploaded files.", storage.uploads_bytes)
    yield _gauge("vitac_database_bytes", "Size of the database.", storage.database_bytes)
    yield from worker_families(state)


def worker_families(state: OperationsView) -> Iterator[Metric]:
    """Yield gauges of the workers: how many in each state, their slots and their disks."""
    counts: dict[str, int] = dict.fromkeys((*WorkerState, LOST), 0)
    slots = 0
    free: dict[str, int] = {}
    total: dict[str, int] = {}
    for worker in state.workers:
        counts[LOST if worker.is_lost else worker.state] += 1
        if worker.is_lost or worker.state is WorkerState.STOPPED:
            continue
        slots += worker.slots if worker.state is WorkerState.READY else 0
        if worker.disk_free_bytes is not None and worker.disk_bytes is not None:
            free[worker.host], total[worker.host] = worker.disk_free_bytes, worker.disk_bytes
    yield _gauges("vitac_workers", "Worker processes of the last hour.", "state", counts)
    yield _gauge("vitac_worker_slots", "Shards that all ready workers can run at once.", slots)
    yield _gauges("vitac_worker_disk_bytes", "Size of a worker machine's disk.", "host", total)
    yield _gauges("vitac_worker_disk_free_bytes", "Free space on a worker machine's disk.", "host", free)


def witness_families(witnesses: Iterable[WitnessView]) -> Iterator[Metric]:
    """Yield how far the witnesses of the competitions are behind the log."""
    views = {view.witness.split("+")[0]: view for view in witnesses}
    entries = {name: float(view.behind) for name, view in views.items()}
    ages = {name: view.behind_s for name, view in views.items()}
    yield _gauges("vitac_witness_behind_entries", "Entries of the log that it has not signed.", "witness", entries)
    yield _gauges("vitac_witness_behind_seconds", "Age of the oldest of these entries.", "witness", ages)


def total_families(counted: Mapping[SeriesKey, float]) -> Iterator[Metric]:
    """Yield the totals in the families of the instruments, with zeros where nothing was counted yet."""
    instruments = Instruments()
    values = {**list_samples(instruments), **counted}
    for family in instruments.registry.collect():
        names = {f"{family.name}{suffix}" for suffix in ("_total", "_bucket", "_count", "_sum")}
        of_family = [key for key in values if key.name in names]
        family.samples = [
            Sample(key.name, key.label_values(), values[key]) for key in sorted(of_family, key=_bucket_order)
        ]
        yield family


def _bucket_order(key: SeriesKey) -> tuple[str, str, float]:
    """Sort buckets of one series by their bounds, as the format asks."""
    labels = key.label_values()
    bound = float(labels.pop("le", "inf"))
    return key.name, str(sorted(labels.items())), bound


def _gauge(name: str, meaning: str, value: float) -> Metric:
    return GaugeMetricFamily(name, meaning, value=value)


def _gauges(name: str, meaning: str, label: str, values: Mapping[str, float]) -> Metric:
    family = GaugeMetricFamily(name, meaning, labels=[label])
    for label_value, value in values.items():
        family.add_metric([label_value], value)
    return family
