"""Traces from the request of an upload to the shards of its evaluation."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.trace import NonRecordingSpan, SpanContext, TraceFlags, use_span
from service_factories import claim, make_principal, shard_ids, submit
from vitac.server import traces
from vitac.server.database.engine import Database

TRACE, SPAN = 0x1234_5678_9ABC_DEF0_1234_5678_9ABC_DEF0, 0x1234_5678_9ABC_DEF0


@pytest.fixture
def received(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[ExportTraceServiceRequest]]:
    """What arrives at a receiver of OTLP over HTTP, to which this process sends its traces."""
    found: list[ExportTraceServiceRequest] = []

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            found.append(ExportTraceServiceRequest.FromString(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    with HTTPServer(("127.0.0.1", 0), Receiver) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", f"http://127.0.0.1:{server.server_port}")
        traces._provider.cache_clear()
        yield found
        server.shutdown()
    traces._provider.cache_clear()


def test_a_shards_span_joins_the_trace_of_the_request_that_its_evaluation_began_in(
    database: Database, received: list[ExportTraceServiceRequest]
) -> None:
    request = NonRecordingSpan(SpanContext(TRACE, SPAN, is_remote=False, trace_flags=TraceFlags(TraceFlags.SAMPLED)))
    with use_span(request), database.transaction() as session:
        shard_id = shard_ids(session, submit(session, make_principal(session)))[0]
    lease = claim(database, shard_id)
    with traces.span("shard", lease.traceparent, {"shard": lease.work_id}) as more:
        more["end"] = "finished"
    traces._provider().shutdown()
    (span,) = received[0].resource_spans[0].scope_spans[0].spans
    assert (int.from_bytes(span.trace_id), int.from_bytes(span.parent_span_id)) == (TRACE, SPAN)
    assert span.name == "shard"
    assert {one.key for one in span.attributes} == {"shard", "end"}


def test_without_a_setting_nothing_is_traced_stored_or_imported(database: Database) -> None:
    with database.transaction() as session:
        shard_id = shard_ids(session, submit(session, make_principal(session)))[0]
    assert claim(database, shard_id).traceparent is None
    code = """
import sys
from vitac.server import traces
with traces.span("shard", None, {}):
    traces.current_traceparent()
sys.exit(any(name.startswith("opentelemetry") for name in sys.modules))
"""
    subprocess.run([sys.executable, "-c", code], check=True)
