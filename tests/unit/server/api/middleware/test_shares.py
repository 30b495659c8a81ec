import asyncio
import time
from collections.abc import Coroutine
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Message
from vitac.server.api.middleware import shares
from vitac.server.api.middleware.shares import AT_WORK, BURST_S, WAITING, Places, SharedTime, Shares, leave_place


class Server:
    """A server whose requests end when the test says so."""

    def __init__(self, *, share: float = 0.1) -> None:
        self.may_end = asyncio.Event()
        self.at_work = 0
        self.order: list[str] = []
        routes = [Route("/page", self.page), Route("/stream", self.stream), Route("/health", self.page)]
        routes += [Route("/uploads", self.page, methods=["POST"]), Route("/uploads/", self.form, methods=["POST"])]
        routes += [Route("/form", self.form, methods=["POST"]), Route("/waits", self.wait)]
        self.app = Shares(Starlette(routes=routes), share=share, apart=[("POST", "/uploads"), ("POST", "/uploads/")])

    async def page(self, request: Request) -> Response:
        request.state.account = request.headers.get("authorization", "").removeprefix("Bearer ")
        self.at_work += 1
        self.order.append(request.client.host if request.client else "")
        await self.may_end.wait()
        return PlainTextResponse("page")

    async def form(self, request: Request) -> Response:
        return PlainTextResponse(await request.body())

    async def wait(self, request: Request) -> Response:
        leave_place(request)
        await asyncio.Event().wait()
        raise AssertionError

    async def stream(self, _: Request) -> Response:
        async def never() -> Any:
            await asyncio.Event().wait()
            yield b""

        return StreamingResponse(never(), media_type="text/event-stream")

    async def ask(self, path: str = "/page", address: str = "192.0.2.1", token: str = "", method: str = "GET") -> int:
        scope: dict[str, Any] = {
            "type": "http", "method": method, "path": path, "query_string": b"", "client": (address, 1),
            "headers": [(b"authorization", b"Bearer " + token.encode())] if token else [],
        }  # fmt: skip
        sent: list[Message] = []

        async def send(message: Message) -> None:
            sent.append(message)

        async def receive() -> Message:
            await asyncio.Event().wait()
            raise AssertionError

        await self.app(scope, receive, send)
        return int(sent[0]["status"])


async def settled() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


def test_a_client_has_so_many_requests_and_probes_need_no_place() -> None:
    async def attack() -> None:
        server = Server()
        flood = [asyncio.create_task(server.ask()) for _ in range(WAITING)]
        await settled()
        assert server.at_work == AT_WORK
        assert await server.ask() == 429
        other = asyncio.create_task(server.ask(address="192.0.2.2"))
        health = asyncio.create_task(server.ask("/health"))
        await settled()
        assert server.at_work == AT_WORK + 1, "a probe needs no place"
        server.may_end.set()
        assert {await one for one in [*flood, other, health]} == {200}

    asyncio.run(attack())


async def order_of(
    server: Server, first: list[Coroutine[Any, Any, int]], *later: Coroutine[Any, Any, int]
) -> list[str]:
    """Return the addresses of requests in the order in which they are worked at; the first ones wait already."""
    tasks = [asyncio.create_task(one) for one in first]
    await settled()
    tasks += [asyncio.create_task(one) for one in later]
    await settled()
    server.may_end.set()
    await asyncio.gather(*tasks)
    return server.order


def test_whoever_asks_for_little_comes_before_a_flood_that_has_used_nothing_yet() -> None:
    server = Server()
    tokens = ["", *(f"team:self made {number}" for number in range(5))]
    flood = [server.ask(token=token, address="192.0.2.1") for token in tokens for _ in range(WAITING // 6)]
    order = asyncio.run(order_of(server, flood, server.ask(address="192.0.2.2")))
    assert order.index("192.0.2.2") == AT_WORK


def test_those_who_use_little_come_in_their_order() -> None:
    server = Server()
    server.app._client("at 192.0.2.2").use(0.5, time.monotonic(), 0.1)
    later = [server.ask(address=f"192.0.2.{number}") for number in (2, 3)]
    order = asyncio.run(order_of(server, [server.ask() for _ in range(AT_WORK)], *later))
    assert order[AT_WORK:] == ["192.0.2.2", "192.0.2.3"]


def test_whoever_has_asked_lately_comes_before_a_flood_that_began_just_now() -> None:
    server = Server()
    server.app._client("at 192.0.2.2").use(0.8, time.monotonic(), 0.1)
    flood = [server.ask() for _ in range(WAITING)]
    order = asyncio.run(order_of(server, flood, server.ask(address="192.0.2.2")))
    assert order.index("192.0.2.2") == AT_WORK


def test_uploads_wait_for_their_turn_and_leave_their_places_to_others_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shares, "UPLOAD_PLACE_S", 0.05)

    async def ask() -> None:
        server = Server()
        uploads = [asyncio.create_task(server.ask("/uploads", method="POST")) for _ in range(2 * AT_WORK)]
        await settled()
        assert server.at_work == AT_WORK
        page = asyncio.create_task(server.ask(address="192.0.2.2"))
        while "192.0.2.2" not in server.order:
            await asyncio.sleep(0.01)
        server.may_end.set()
        assert {await one for one in (*uploads, page)} == {200}

    asyncio.run(ask())


@pytest.mark.parametrize("path", ["/form", "/uploads/"])
def test_a_body_that_trickles_and_what_only_waits_hold_no_place(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shares, "PLACE_TIMEOUT_S", 0.05)

    async def ask() -> None:
        server = Server()
        trickling = [asyncio.create_task(server.ask(path, method="POST")) for _ in range(2 * AT_WORK)]
        waiting = [asyncio.create_task(server.ask("/waits")) for _ in range(2 * AT_WORK)]
        await settled()
        server.may_end.set()
        assert await server.ask(address="192.0.2.2") == 200
        for task in (*trickling, *waiting):
            task.cancel()
        await asyncio.gather(*trickling, *waiting, return_exceptions=True)

    asyncio.run(ask())


def test_where_all_who_are_at_work_hang_the_others_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shares, "PLACE_TIMEOUT_S", 0.05)

    async def ask() -> None:
        server = Server()
        hanging = [asyncio.create_task(server.ask()) for _ in range(AT_WORK)]
        await settled()
        assert await server.ask(address="192.0.2.2") == 503
        server.may_end.set()
        await asyncio.gather(*hanging)
        assert await server.ask(address="192.0.2.2") == 200

    asyncio.run(ask())


def test_who_is_known_by_a_token_counts_for_the_account_and_not_for_the_address() -> None:
    async def ask() -> None:
        server = Server()
        server.may_end.set()
        assert await server.ask(token="team:Ants") == 200  # noqa: S106 - made up
        server.may_end.clear()
        flood = [asyncio.create_task(server.ask()) for _ in range(WAITING)]
        await settled()
        assert await server.ask(token="guess") == 429  # noqa: S106
        known = asyncio.create_task(server.ask(token="team:Ants"))  # noqa: S106
        await settled()
        server.may_end.set()
        assert {await one for one in [known, *flood]} == {200}

    asyncio.run(ask())


@pytest.mark.parametrize(("share", "token", "status"), [(0.1, "", 429), (1.0, "", 200), (0.1, "organizer:1", 200)])
def test_who_has_used_up_its_share_of_the_time_waits_but_for_organizers(share: float, token: str, status: int) -> None:
    async def ask() -> None:
        server = Server(share=share)
        server.may_end.set()
        await server.ask(token=token)
        await server.ask(token=token)
        for client in server.app._clients.values():
            client.used_s = BURST_S + 100.0
        assert await server.ask(token=token) == status
        assert await server.ask(address="192.0.2.2") == 200

    asyncio.run(ask())


def test_an_open_stream_takes_no_place() -> None:
    async def ask() -> None:
        server = Server()
        streams = [asyncio.create_task(server.ask("/stream")) for _ in range(2 * AT_WORK)]
        await settled()
        server.may_end.set()
        assert await server.ask() == 200
        for stream in streams:
            stream.cancel()
        await asyncio.gather(*streams, return_exceptions=True)

    asyncio.run(ask())


def test_clients_are_forgotten_once_their_share_covers_what_they_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shares, "MAX_CLIENTS", 3)
    monkeypatch.setattr(SharedTime, "end", lambda *_: 0.0)

    async def ask() -> int:
        server = Server()
        server.may_end.set()
        for number in range(10):
            await server.ask(address=f"192.0.2.{number}")
        return len(server.app._clients)

    assert asyncio.run(ask()) <= 3


def test_places_go_to_the_lowest_rank_as_it_is_by_then() -> None:
    async def take_all() -> list[str]:
        places, order = Places(1), list[str]()
        ranks = {"flood": 0.0, "gone": 1.0, "flood again": 0.0, "honest": 2.0, "honest too": 2.0}
        await places.take(lambda: 0.0)

        async def work(name: str) -> None:
            await places.take(lambda: ranks[name])
            order.append(name)
            places.leave()

        tasks = [asyncio.create_task(work(name)) for name in ranks]
        await asyncio.sleep(0)
        ranks["flood"] = ranks["flood again"] = 5.0
        tasks[1].cancel()
        places.leave()
        await asyncio.gather(*tasks, return_exceptions=True)
        return order

    assert asyncio.run(take_all()) == ["honest", "honest too", "flood", "flood again"]


def test_requests_at_work_share_the_time_that_passes() -> None:
    now = [0.0]
    shared = SharedTime(lambda: now[0])
    first = shared.begin()
    now[0] = 1.0
    second = shared.begin()
    now[0] = 3.0
    assert shared.end(second) == 1.0
    now[0] = 4.0
    assert shared.end(first) == 3.0
