"""Counts open event streams, those of the API and of the pages together: all of the server, and those of each team."""

from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass

from fastapi.concurrency import run_in_threadpool

from ..db.states import Quota
from ..limiter import ConcurrencyLimiter
from ..principals import Principal
from ..quotas import exceeded, limit_of
from ..services import Services


@dataclass(frozen=True, kw_only=True)
class OpenStreams:
    """The event streams that are open now.

    Attributes:
        services: of this process.
        limiter: counts for all server processes together.
    """

    services: Services
    limiter: ConcurrencyLimiter

    @asynccontextmanager
    async def one(self, principal: Principal) -> AsyncIterator[None]:
        """Count a stream while the block runs.

        Raises:
            ServiceError: the server keeps no more open, or the team has as many as its quota says.
        """
        limit = await run_in_threadpool(self._limit_of, principal)
        with ExitStack() as stack:
            stack.enter_context(self.limiter.one("all", "event streams"))
            if limit is not None and not stack.enter_context(self.limiter.place(principal.account, limit)):
                raise exceeded(principal.team_name or principal.account, Quota.EVENT_STREAMS, limit)
            yield

    async def require_place(self, principal: Principal) -> None:
        """Refuse one stream too many before its answer begins.

        Raises:
            ServiceError: as `one`.
        """
        async with self.one(principal):
            pass

    def _limit_of(self, principal: Principal) -> int | None:
        if principal.team_id is None:
            return None
        with self.services.database.transaction() as session:
            return limit_of(session, self.services.settings.quotas, principal.team_id, Quota.EVENT_STREAMS)
