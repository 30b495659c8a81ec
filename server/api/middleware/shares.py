"""Shares of requests: how many one address and one network may send."""

import asyncio
import heapq
import itertools
import math
import time
from collections.abc import Callable, Collection
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from hashlib import sha256

import structlog
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...database.states import Role
from ...errors import ProblemCode, ServiceError
from ..access import get_client_address
from ..problems import problem
from .requests import HttpMiddleware, matches_route


class Places:
    """Places for requests at work: the lowest rank comes first, and of equal ones whoever has waited longest.

    Ranks are asked for again when a place is free: whoever sends many requests has a higher one with each.
    """

    def __init__(self, count: int) -> None:
        self._free = count
        self._turns = itertools.count()
        self._waiting: list[tuple[float, int, Callable[[], float], asyncio.Future[None]]] = []

    async def take(self, rank: Callable[[], float]) -> None:
        """Wait for a place."""
        if self._free:
            self._free -= 1
            return
        given = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (rank(), next(self._turns), rank, given))
        try:
            await given
        except asyncio.CancelledError:
            if not given.cancelled():  # it was given one, and nobody will use it
                self.leave()
            raise

    def leave(self) -> None:
        """Give a place to the next."""
        while self._waiting:
            _, turn, rank, given = heapq.heappop(self._waiting)
            if given.done():
                continue
            now = rank(), turn, rank, given
            if self._waiting and now[:2] > self._waiting[0][:2]:
                heapq.heappush(self._waiting, now)
                continue
            given.set_result(None)
            return
        self._free += 1


class SharedTime:
    """Tells what part of the process's processor time belongs to a request: at each moment all at work share it."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self._clock = clock
        self._at_work = 0
        self._of_one_s, self._at_s = 0.0, clock()

    def begin(self) -> float:
        """Note that a request begins; return what `end` wants to know."""
        self._advance()
        self._at_work += 1
        return self._of_one_s

    def end(self, begun_s: float) -> float:
        """Note that a request ends; return its part [s]."""
        self._advance()
        self._at_work -= 1
        return self._of_one_s - begun_s

    def _advance(self) -> None:
        now_s = self._clock()
        if self._at_work:
            self._of_one_s += (now_s - self._at_s) / self._at_work
        self._at_s = now_s


logger = structlog.get_logger(__name__)


AT_WORK = 4
"""Requests that a process works at; they share one processor, and each further one slows down all others."""
WAITING = 48
"""Requests of one client that are not answered; further ones are refused."""
BURST_S = 10.0
"""Processor time that a client may use at once, before its share of all time counts."""
PLACE_TIMEOUT_S = 15.0
"""Longest time that a request waits for a place before it is refused."""
BUSY = "The server is busy, or its database does not answer; try again in a moment."
HALF_LIFE_S = 10.0
"""Time after which half of what a client has used lately is forgotten."""
REQUEST_S = 0.05
"""Processor time that a request is taken for before it is known, so that many at once come after a single one."""
REFUSAL_S = 0.001
"""Processor time that a refusal is taken for."""
LITTLE_S = 1.0
"""Processor time up to which all clients wait in the order of their requests."""
UPLOAD_PLACE_S = 0.5
"""Longest time for which an upload has a place: to check a large one takes much longer."""
MAX_CLIENTS = 10_000
"""Clients that are remembered; then those are forgotten that have not asked for long."""
LEAVE_PLACE = "leave_place"
_ALWAYS_ANSWERED = ("/health", "/ready")
_WITHOUT_BODY = frozenset({"GET", "HEAD", "OPTIONS"})


@dataclass
class ClientUse:
    """What one client uses now.

    Attributes:
        requests: that have not been answered.
        expected: of these, how many wait for a place or have one.
        used_s: processor time that its share has not yet covered.
        lately_s: processor time, of which half is forgotten after `HALF_LIFE_S`.
        at_s: when both were so.
    """

    requests: int = 0
    expected: int = 0
    used_s: float = 0.0
    lately_s: float = 0.0
    at_s: float = 0.0

    def is_idle(self, share: float) -> bool:
        """Return whether nothing of it has to be remembered."""
        self.use(0.0, time.monotonic(), share)
        return not self.requests and not self.used_s

    def use(self, used_s: float, now_s: float, share: float) -> None:
        """Add processor time, less what the share of the time since has covered."""
        self.used_s = max(0.0, self.used_s - (now_s - self.at_s) * share) + used_s
        self.lately_s = self._left_of_lately(now_s) + used_s
        self.at_s = now_s

    def expect(self, now_s: float) -> float:
        """Return what it has used lately, with what its expected requests will [s]."""
        return self._left_of_lately(now_s) + REQUEST_S * self.expected

    def _left_of_lately(self, now_s: float) -> float:
        return self.lately_s * math.pow(0.5, (now_s - self.at_s) / HALF_LIFE_S)


class _Turn:
    """The place of a request, which it may have several times; `first`: before all others."""

    def __init__(
        self, places: Places, shared: SharedTime, clients: Collection[ClientUse], *, share: float, first: bool
    ) -> None:
        self._places, self._time, self._clients, self._share, self._first = places, shared, clients, share, first
        self._held = ExitStack()

    async def begin(self, limit_s: float | None) -> None:
        """Wait for a place, and leave it after `limit_s` at the latest.

        Raises:
            ServiceError: there was none for long.
        """
        self._expect(1)
        self._held.callback(self._expect, -1)
        try:
            async with asyncio.timeout(PLACE_TIMEOUT_S):
                await self._places.take(self._rank)
        except TimeoutError:
            raise ServiceError(ProblemCode.DATABASE_UNAVAILABLE, BUSY) from None
        self._held.callback(self._places.leave)
        self._held.callback(self._charge, self._time.begin())
        if limit_s is not None:
            self._held.callback(asyncio.get_running_loop().call_later(limit_s, self.end).cancel)

    def end(self) -> None:
        """Leave the place, where there is one."""
        self._held.close()

    def _expect(self, more: int) -> None:
        for one in self._clients:
            one.expected += more

    def _rank(self) -> float:
        """Return 0 for little, and 1 more each time that what its clients use doubles."""
        if self._first:
            return -1.0
        now_s = time.monotonic()
        uses_s = sum(one.expect(now_s) for one in self._clients)
        return math.ceil(math.log2(max(1.0, uses_s / LITTLE_S)))

    def _charge(self, begun_s: float) -> None:
        used_s, now_s = self._time.end(begun_s), time.monotonic()
        for one in self._clients:
            one.use(used_s, now_s, self._share)


class Shares(HttpMiddleware):
    """ASGI middleware.

    Args:
        app: what answers the requests.
        share: of a process's time that one client may use in the long run; 1 or more: all of it.
        apart: methods and paths of uploads.
    """

    def __init__(self, app: ASGIApp, *, share: float, apart: Collection[tuple[str, str]] = ()) -> None:
        super().__init__(app)
        self._share = share
        self._apart = frozenset(apart)
        self._time = SharedTime()
        self._places = Places(AT_WORK)
        self._clients: dict[str, ClientUse] = {}
        self._accounts: dict[bytes, str] = {}
        self._is_warned = False

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on when its client has a place, or refuse it."""
        if scope["path"] in _ALWAYS_ANSWERED:
            await self._app(scope, receive, send)
            return
        neighbours = self._client(f"at {get_client_address(HTTPConnection(scope))}")
        key = self._choose_key(scope)
        client, is_upload = self._client(key), matches_route(self._apart, scope)
        refusal = None if is_upload else self._refusal(key, client)
        if refusal is not None:
            neighbours.use(REFUSAL_S, time.monotonic(), self._share)
            await _answer(scope, refusal)(scope, receive, send)
            return
        both = client, neighbours
        turn = _Turn(self._places, self._time, both, share=self._share, first=_is_privileged(key))
        for one in both:
            one.requests += 1
        try:
            await self._work(turn, scope, receive, send, is_upload=is_upload)
        finally:
            turn.end()
            for one in both:
                one.requests -= 1
            self._note_account(scope)

    async def _work(self, turn: "_Turn", scope: Scope, receive: Receive, send: Send, *, is_upload: bool) -> None:
        """Hand the request on; it has a place from when its body is there until its answer begins.

        So neither a body that trickles nor an answer that nobody reads holds one. An upload has one also until it asks
        for its body, and each time for `UPLOAD_PLACE_S` at most.
        """
        has_body, limit_s = scope["method"] not in _WITHOUT_BODY, UPLOAD_PLACE_S if is_upload else None

        async def received() -> Message:
            nonlocal has_body
            if has_body:
                turn.end()
            message = await receive()
            if has_body and message["type"] == "http.request" and not message.get("more_body", False):
                has_body = False
                await turn.begin(limit_s)
            return message

        async def sent(message: Message) -> None:
            turn.end()
            await send(message)

        loop = asyncio.get_running_loop()
        scope.setdefault("state", {})[LEAVE_PLACE] = partial(loop.call_soon_threadsafe, turn.end)
        if is_upload or not has_body:
            try:
                await turn.begin(limit_s)
            except ServiceError as refusal:
                await _answer(scope, refusal)(scope, receive, send)
                return
        await self._app(scope, received, sent)

    def _client(self, key: str) -> ClientUse:
        if len(self._clients) >= MAX_CLIENTS:
            for one in [one for one, client in self._clients.items() if client.is_idle(self._share)]:
                del self._clients[one]
        return self._clients.setdefault(key, ClientUse(at_s=time.monotonic()))

    def _refusal(self, key: str, client: ClientUse) -> ServiceError | None:
        if client.requests >= WAITING:
            return _too_many(f"{client.requests} of your requests are waiting, which is the maximum", 2)
        client.use(0.0, time.monotonic(), self._share)
        if self._share >= 1.0 or _is_privileged(key) or client.used_s <= BURST_S:
            return None
        wait_s = max(1, round((client.used_s - BURST_S) / self._share))
        return _too_many("Your requests have used the share of this server's time that one client may have", wait_s)

    def _choose_key(self, scope: Scope) -> str:
        """Return for whom a request counts; credentials that have not been found good count for the address."""
        credentials = _credentials(scope)
        account = self._accounts.get(credentials) if credentials else None
        if not self._is_warned and any(name == b"x-forwarded-for" for name, _ in scope["headers"]):
            self._is_warned = True
            client = scope.get("client") or ("unknown",)
            logger.info("forwarded_request", counted_for=client[0], advice="VITAC_TRUSTED_PROXIES names the proxies")
        return account or f"address {get_client_address(HTTPConnection(scope))}"

    def _note_account(self, scope: Scope) -> None:
        """Remember whose credentials they were, where a route has found out."""
        credentials, account = _credentials(scope), scope.get("state", {}).get("account")
        if credentials and account:
            if len(self._accounts) >= MAX_CLIENTS:
                self._accounts.clear()
            self._accounts[credentials] = account


def _credentials(scope: Scope) -> bytes:
    """Return a digest of token or session; empty without."""
    given = [value for name, value in scope["headers"] if name in (b"authorization", b"cookie")]
    return sha256(b"\n".join(given)).digest() if given else b""


def _is_privileged(key: str) -> bool:
    """Return whether somebody is kept waiting by nobody."""
    return key.startswith((f"{Role.ORGANIZER}:", f"{Role.JUDGE}:"))


def leave_place(request: Request) -> None:
    """Let another request be worked at while this one waits for something else than the processor; from any thread."""
    leave: Callable[[], object] = getattr(request.state, LEAVE_PLACE, lambda: None)
    leave()


def _too_many(what: str, wait_s: int) -> ServiceError:
    return ServiceError(ProblemCode.TOO_MANY_REQUESTS, f"{what}; wait {wait_s} s.", retry_after_s=wait_s)


def _answer(scope: Scope, refusal: ServiceError) -> Response:
    """Return a refusal that costs little: whoever gets it may ask again at once."""
    answer = problem(Request(scope), refusal)
    if not scope["path"].startswith("/api/"):
        return PlainTextResponse(refusal.detail, answer.status_code, {"Retry-After": answer.headers["Retry-After"]})
    return answer
