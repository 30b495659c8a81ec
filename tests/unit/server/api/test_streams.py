import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from uuid import UUID, uuid4

import pytest
from vitac.server.api import streams
from vitac.server.api.streams import OpenStreams
from vitac.server.database.states import Role
from vitac.server.errors import ServiceError
from vitac.server.limiter import ConcurrencyLimiter
from vitac.server.principals import Principal

TOTAL = 20


def make_team() -> Principal:
    name = str(uuid4())
    return Principal(role=Role.TEAM, team_id=UUID(int=1), team_name=name)


async def opened(stack: AsyncExitStack, limiter: ConcurrencyLimiter, address: str, by: Principal) -> bool:
    """Open a stream; return whether there was a place."""
    services = cast(Any, SimpleNamespace())
    try:
        await stack.enter_async_context(OpenStreams(services=services, limiter=limiter, address=address).one(by))
    except ServiceError:
        return False
    return True


def test_self_made_teams_leave_streams_to_other_addresses_and_to_organizers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OpenStreams, "_find_limit", lambda *_: None)
    limiter = ConcurrencyLimiter(tmp_path / "streams", TOTAL)

    async def attack() -> None:
        async with AsyncExitStack() as stack:
            of_one = [await opened(stack, limiter, "192.0.2.1", make_team()) for _ in range(TOTAL)]
            assert sum(of_one) == TOTAL * streams.SHARE_OF_ADDRESS
            assert await opened(stack, limiter, "192.0.2.2", make_team())
            of_many = [await opened(stack, limiter, f"192.0.2.{n}", make_team()) for n in range(3, TOTAL + 3)]
            assert sum(of_one) + 1 + sum(of_many) == TOTAL * streams.SHARE_OF_TEAMS
            assert await opened(stack, limiter, "192.0.2.1", Principal(role=Role.ORGANIZER, token_id=UUID(int=2)))

    asyncio.run(attack())
