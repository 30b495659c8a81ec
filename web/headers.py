"""Security headers on every page. Called by `routes.install`.

Pages load only our own static files, so the policy forbids everything else: no inline script or style, no frames, no
other origin. The embedded player alone may stand in frames of other sites.
"""

from dataclasses import dataclass

from starlette.datastructures import MutableHeaders
from starlette.types import Message, Receive, Scope, Send
from vitac.evaluator.agent.limits import Limits
from vitac.server.api.middleware.requests import HttpMiddleware, when_answered

CONTENT_SECURITY_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
EMBEDDED = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY.replace("frame-ancestors 'none'", "frame-ancestors *"),
    "Cross-Origin-Resource-Policy": "cross-origin",
}
"""Headers of an answer that other sites may show in a frame."""


class SecurityHeaders(HttpMiddleware):
    """ASGI middleware that adds `HEADERS` to each answer that does not set them itself."""

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add the headers to the start of the answer."""

        def add(message: Message) -> None:
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            if headers["Content-Security-Policy"] == EMBEDDED["Content-Security-Policy"]:
                del headers["X-Frame-Options"]

        await self._app(scope, receive, when_answered(send, add))


UNITS = (("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10))


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One line of a table of limits."""

    title: str
    value: str


def limit_rows(limits: Limits) -> tuple[LimitRow, ...]:
    """Return the limits on a submission, from upload to evaluation."""
    rows = {
        "Archive, packed": size(limits.archive_packed_bytes),
        "Archive, unpacked": size(limits.archive_unpacked_bytes),
        "Files and folders in the archive": f"{limits.archive_files:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
        "Folder depth in the archive": str(limits.archive_depth),
        "Ratio of unpacked to packed size": f"{limits.archive_ratio:g}",
        "Container image, packed and unpacked": size(limits.image_bytes),
        "Files and folders in a container image": f"{limits.image_files:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
        "Start (import and load)": time_limits(limits.start_cpu_s, limits.start_wall_s),
        "One action": time_limits(limits.action_cpu_s, limits.action_wall_s),
        "One episode": time_limits(limits.episode_cpu_s, None),
        "All episodes of a shard, with loading": time_limits(limits.shard_cpu_s, limits.shard_wall_s),
        "Memory of the policy and its children": size(limits.memory_bytes),
        "Address space of one process": size(limits.address_space_bytes),
        "Processes and threads": str(limits.processes),
        "Open files": str(limits.open_files),
        "Size of one written file": size(limits.file_size_bytes),
        "Files in /tmp": size(limits.tmp_bytes),
        "Shared memory": size(limits.shm_bytes),
        "Output stored for the team": size(limits.output_kept_bytes),
        "Output at which the policy is stopped": size(limits.output_killed_bytes),
        "Network": "none",
    }
    return tuple(LimitRow(title=title, value=value) for title, value in rows.items())


def size(count: int) -> str:
    """Format a number of bytes in its largest unit: `512 MiB`."""
    for unit, unit_bytes in UNITS:
        if count >= unit_bytes:
            return f"{count / unit_bytes:.4g} {unit}"
    return f"{count} bytes"


def time_limits(cpu_s: float, wall_s: float | None) -> str:
    """Format a limit on CPU time and, if there is one, on wall time [s]."""
    cpu = f"{cpu_s:g} s of CPU time"
    return cpu if wall_s is None else f"{cpu}, {wall_s:g} s of wall time"
