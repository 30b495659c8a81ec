"""The protocol of connections whose clients may be slow; workers load `web_server` beside it, but have no uvicorn."""

import asyncio
from typing import Any, Final

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_TIMEOUT_S: Final = 10.0


class BoundedHeadProtocol(H11Protocol):
    """Closes a connection that sends no complete request line and headers within `HEAD_TIMEOUT_S`.

    Else a client that sends a byte now and then holds a connection for ever. Between two requests uvicorn's own limit
    for idle connections holds; bodies have limits of their own.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the time for the first request."""
        super().connection_made(transport)
        self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the time."""
        self._stop_timer()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Handle what was received; the time runs on for as long as the head of a request is incomplete."""
        super().handle_events()
        unread, _ = self.conn.trailing_data
        if self.conn.their_state is not h11.IDLE:
            self._stop_timer()
        elif unread and self._head_timer is None:
            self._start_timer()

    def _start_timer(self) -> None:
        self._head_timer = self.loop.call_later(HEAD_TIMEOUT_S, self.transport.close)

    def _stop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None
