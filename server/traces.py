"""Traces from a request to the shards of its evaluation (OpenTelemetry); without cost where none are asked for.

FastAPI itself sends a span of each request. An evaluation stores the trace in which it began, and workers add a span
for each shard.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from vitac.envs.extras import explain_missing
from vitac.errors import VitacError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider


class TelemetryMissing(VitacError):
    """Traces are asked for without the packages of the extra `telemetry`; install it."""


ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
"""Standard variables, which OpenTelemetry's own packages read; one of them asks for traces."""


def are_asked_for() -> bool:
    """Return whether this process sends traces."""
    return any(os.environ.get(name) for name in ENDPOINTS)


def require_packages() -> None:
    """Refuse to start without what sends traces, where they are asked for.

    Raises:
        TelemetryMissing: its packages are not installed.
    """
    if are_asked_for() and not (find_spec("opentelemetry") and find_spec("opentelemetry.exporter")):
        raise TelemetryMissing(
            f"{' or '.join(ENDPOINTS)} asks for traces; unset it, or install what sends them. "
            + explain_missing("opentelemetry.exporter", "telemetry", "It")
        )


def current_traceparent() -> str | None:
    """Return the trace of the present request (W3C traceparent); None where nothing is traced."""
    if not are_asked_for():
        return None
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    return carrier.get("traceparent")


@contextmanager
def span(name: str, traceparent: str | None, attributes: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Send a span of the block, in a trace if there is one; values put into what is yielded become attributes."""
    later: dict[str, Any] = {}
    if not are_asked_for():
        yield later
        return
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    parent = TraceContextTextMapPropagator().extract({"traceparent": traceparent} if traceparent else {})
    tracer = _provider().get_tracer("vitac")
    with tracer.start_as_current_span(name, context=parent, attributes=attributes) as started:
        yield later
        started.set_attributes(later)


@cache
def _provider() -> "TracerProvider":
    """Return what sends this process's spans, in batches and at its end."""
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
    from opentelemetry.sdk.resources import SERVICE_NAME, Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor

    resource = Resource.create({SERVICE_NAME: os.environ.get("OTEL_SERVICE_NAME", "vitac-worker")})
    provider = TracerProvider(resource=resource)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    return provider
