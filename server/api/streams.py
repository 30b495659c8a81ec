"""Counts open event streams, those of API and pages together: all of the server, of each team and of each address."""

from collections.abc import AsyncIterable, AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Self

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.types import Receive, Scope, Send

from ..accounts.quotas import exceeded, find_limits
from ..database.states import Quota
from ..limiter import ConcurrencyLimiter
from ..principals import Principal
from ..services import Services
from .access import get_client_address

SHARE_OF_TEAMS = 0.9
"""The rest is for organizers and judges, whatever teams do."""
SHARE_OF_ADDRESS = 0.2
"""One person may register several teams."""


@dataclass(frozen=True, kw_only=True)
class OpenStreams:
    """The event streams that are open now.

    Attributes:
        services: of this process.
        limiter: counts for all server processes together.
        address: of the client.
    """

    services: Services
    limiter: ConcurrencyLimiter
    address: str

    @classmethod
    def from_request(cls, request: Request, services: Services) -> Self:
        """Return those of the server that answers a request."""
        return cls(services=services, limiter=request.app.state.stream_limiter, address=get_client_address(request))

    @asynccontextmanager
    async def one(self, principal: Principal) -> AsyncIterator[None]:
        """Count a stream while the block runs.

        Raises:
            ServiceError: the server, the address or the team has reached its limit.
        """
        limit = await run_in_threadpool(self._find_limit, principal)
        with ExitStack() as stack:
            if principal.team_id is not None:
                what = "event streams from one address"
                stack.enter_context(self.limiter.one(f"address {self.address}", what, share=SHARE_OF_ADDRESS))
            share = 1.0 if principal.team_id is None else SHARE_OF_TEAMS
            stack.enter_context(self.limiter.one("all", "event streams", share=share))
            if limit is not None and not stack.enter_context(self.limiter.place(principal.account, limit)):
                raise exceeded(principal.team_name or principal.account, Quota.EVENT_STREAMS, limit)
            yield

    def _find_limit(self, principal: Principal) -> int | None:
        if principal.team_id is None:
            return None
        with self.services.database.transaction() as session:
            return find_limits(session, self.services.settings.quotas, principal.team_id)[Quota.EVENT_STREAMS]


class CountedStream(EventSourceResponse):
    """An event stream that counts from before its answer begins, so that one too many is refused.

    Args:
        streams: among which it counts.
        principal: whose stream it is.
        events: to send.
        options: of `EventSourceResponse`.
    """

    def __init__(
        self, streams: OpenStreams, principal: Principal, events: AsyncIterable[ServerSentEvent], **options: Any
    ) -> None:
        super().__init__(events, **options)
        self._streams = streams
        self._principal = principal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events.

        Raises:
            ServiceError: as `OpenStreams.one`.
        """
        async with self._streams.one(self._principal):
            await super().__call__(scope, receive, send)
