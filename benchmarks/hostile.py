"""Do honest teams notice hostile clients? What do sign-ins of strangers cost a board?

Run it as `python benchmarks/hostile.py [--hostile 200] [--honest 20] [--seconds 60] [--json FILE]`. It starts a server
of its own and asks it over addresses of the loopback network (127.0.0.0/8) only, and ends within ten minutes. Hostile
clients come from ten addresses: they guess passwords, load pages, hold event streams, ask with the tokens of teams
that they made, and send what is no request. Honest teams, each with an address of its own, look at a board and at their
submissions, upload one, follow it, and sign in. Counted are their times, and answers that they should not have got.
Printed last is which aims are missed; then the exit code is 1. The clients use the same cores as the server: `cores`
says for how much of the time their threads, all together, ran and waited for a core.
"""

import argparse
import asyncio
import io
import json
import os
import sys
import time
import zipfile
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from random import random
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import numpy as np
from uploads import EXAMPLE, cpu_s, server

BOARD = "/tracks/track_1"
API = "/api/v1"
N_ADDRESSES = 10
MAX_S = 480.0
SETTLE_S = 3.0
PAUSE_S = 1.0
"""An honest client looks at what it got before it asks again."""
TIMEOUT_S = 30.0
SLOW_S = 1.0
BOARD_MS = 100.0
"""Aim for a board during sign-ins of strangers."""
CORES = ("server_ran", "server_waited", "hostile_clients_ran", "hostile_clients_waited")
STREAMS_OF_TEAM = 20
STREAMS_WATCHED_S = 30.0
ZIP = {"content-type": "application/zip"}
PASSWORD = "correct horse battery"  # noqa: S105 - made up


def main() -> int:
    """Measure and print; return whether an aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hostile", type=int, default=200)
    parser.add_argument("--honest", type=int, default=20)
    parser.add_argument("--streams", type=int, default=500, help="event streams that are open at the same time")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each part")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    seconds = min(arguments.seconds, MAX_S / 2)
    with TemporaryDirectory(prefix="vitac-hostile-") as name:
        folder = Path(name)
        folder.chmod(0o711)
        with server(folder) as (process, client):
            figures: dict[str, Any] = {
                "load_average_before": round(os.getloadavg()[0], 2),
                "sign_ins": asyncio.run(measure_sign_ins(client.server, arguments.hostile)),
                "streams": asyncio.run(measure_streams(client.server, process.pid, arguments.streams)),
                "honest_alone": measure_attack(client.server, process.pid, 0, arguments.honest, seconds),
                "attack": measure_attack(client.server, process.pid, arguments.hostile, arguments.honest, seconds),
            }
    print(json.dumps(figures, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    missed = list_missed(figures["sign_ins"], figures["attack"])
    print("\n".join(f"MISSED {each}" for each in missed) or "every aim is reached")
    return 1 if missed else 0


def list_missed(sign_ins: dict[str, Any], attack: dict[str, Any]) -> list[str]:
    """Return a sentence for each aim that is missed."""
    aims = {
        f"a board during sign-ins took {sign_ins['board_max_ms']} ms": sign_ins["board_max_ms"] < BOARD_MS,
        f"honest requests took more than {SLOW_S:g} s: {attack['slow']}": not attack["over_1_s"],
        f"honest requests got wrong answers: {attack['wrong']}": not attack["wrong"],
        f"of {attack['uploaded']} uploads {attack['found_again']} were found": attack["uploaded"]
        == attack["found_again"],
    }
    return [sentence for sentence, is_reached in aims.items() if not is_reached]


def visitor(address: str, number: int, *, group: int) -> httpx.AsyncClient:
    """Return a client with an address of the loopback network."""
    local = f"127.0.{group}.{number + 1}"
    limits = httpx.Limits(max_connections=None)
    transport = httpx.AsyncHTTPTransport(local_address=local, limits=limits)
    hooks = {"request": [follow_phases]}
    return httpx.AsyncClient(base_url=address, transport=transport, timeout=TIMEOUT_S, event_hooks=hooks)


async def measure_sign_ins(address: str, n: int) -> dict[str, Any]:
    """Ask for a board again and again while strangers in another process guess passwords all at once."""
    times: list[float] = []
    receiver, sender = get_context("spawn").Pipe(duplex=False)
    guessing = get_context("spawn").Process(target=run_guesses, args=(address, n, sender), daemon=True)
    guessing.start()
    async with visitor(address, 0, group=1) as board:
        await board.get(BOARD)
        await asyncio.to_thread(receiver.recv)  # all are there
        while not receiver.poll():
            begun = time.perf_counter()
            (await board.get(BOARD)).raise_for_status()
            times.append(time.perf_counter() - begun)
            await asyncio.sleep(0.02)
    answers = receiver.recv()
    guessing.join()
    return {"answers": answers, "board_requests": len(times), "board_max_ms": milliseconds(max(times))}


def run_guesses(address: str, n: int, sender: Connection) -> None:
    """Guess a password with many clients at once; send a word before, and then the answers."""
    asyncio.run(_guess_all(address, n, sender))


async def _guess_all(address: str, n: int, sender: Connection) -> None:
    guessers = [visitor(address, number % N_ADDRESSES, group=2) for number in range(n)]
    guess = {"team": "benchmark", "member": "captain", "password": PASSWORD}
    sender.send("ready")
    answers = await asyncio.gather(*(one.post("/sign-in/password", data=guess) for one in guessers))
    sender.send(Counter(one.status_code for one in answers))
    for one in guessers:
        await one.aclose()


async def measure_streams(address: str, pid: int, n: int) -> dict[str, Any]:
    """Hold event streams of submissions that wait; measure what they cost and how long a board takes beside them."""
    clients = [visitor(address, number, group=4) for number in range(-(-n // STREAMS_OF_TEAM))]
    opened: list[str] = []

    async def follow(client: httpx.AsyncClient, path: str, headers: dict[str, str]) -> None:
        async with client.stream("GET", path, headers=headers) as stream:
            async for line in stream.aiter_lines():
                if line.startswith("data:"):
                    opened.append(line)

    following = []
    for number, client in enumerate(clients):
        headers = {"authorization": f"Bearer {await register(client, f'Followers {number}')}"}
        sent = await client.post(
            f"{API}/submissions", headers={**headers, **ZIP}, content=archive(f"followed {number}")
        )
        path = f"{API}/submissions/{sent.json()['id']}/events"
        following += [asyncio.create_task(follow(client, path, headers)) for _ in range(STREAMS_OF_TEAM)]
    while len(opened) < n and not any(one.done() for one in following):
        await asyncio.sleep(0.1)
    begun, begun_cpu_s, times = time.monotonic(), cpu_s(pid), list[float]()
    async with visitor(address, 0, group=1) as board:
        while time.monotonic() - begun < STREAMS_WATCHED_S:
            asked = time.perf_counter()
            (await board.get(BOARD)).raise_for_status()
            times.append(time.perf_counter() - asked)
            await asyncio.sleep(PAUSE_S)
    share = (cpu_s(pid) - begun_cpu_s) / (time.monotonic() - begun)
    for one in following:
        one.cancel()
    await asyncio.gather(*following, return_exceptions=True)
    return {"open": len(following), "heard": len(opened), "server_cpu": round(share, 2),
            "board_max_ms": milliseconds(max(times))}  # fmt: skip


def measure_attack(address: str, pid: int, n_hostile: int, n_honest: int, seconds: float) -> dict[str, Any]:
    """Let honest and hostile clients ask from a process of their own each, and return what the honest ones saw."""
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    attack = context.Process(target=run_hostile, args=(address, n_hostile, seconds + 2 * SETTLE_S), daemon=True)
    honest = context.Process(target=run_honest, args=(address, pid, n_honest, seconds, sender), daemon=True)
    honest.start()
    receiver.recv()  # all are there
    attack.start()
    begun, before = time.monotonic(), [*core_s(pid), *core_s(attack.pid)]
    if not receiver.poll(MAX_S):
        raise SystemExit("The honest clients did not end.")
    found: dict[str, Any] = receiver.recv()
    used = np.subtract([*core_s(pid), *core_s(attack.pid)], before) / (time.monotonic() - begun)
    found["cores"] = dict(zip(CORES, used.round(2).tolist(), strict=True))
    for process in (honest, attack):
        process.join(SETTLE_S)
        process.kill()
    return found


def core_s(pid: int | None) -> tuple[float, float]:
    """Return how long the threads of a process have run, and how long they have waited for a core [s]."""
    found = np.zeros(2)
    for file in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with suppress(OSError):  # the thread has ended
            found += [int(part) / 1e9 for part in file.read_text().split()[:2]]
    return found[0], found[1]


@dataclass
class Phases:
    """How long each phase of a request took, as httpx reports them."""

    begun_s: dict[str, float] = field(default_factory=dict)
    took_s: dict[str, float] = field(default_factory=dict)

    async def note(self, event: str, _: object) -> None:
        """Take notice of the begin or end of a phase, such as `http11.receive_response_headers.started`."""
        phase, _, moment = event.rpartition(".")
        if moment == "started":
            self.begun_s[phase] = time.perf_counter()
        else:
            self.took_s[phase] = time.perf_counter() - self.begun_s[phase]

    def longest(self) -> str:
        """Return the phase that took longest."""
        return max(self.took_s, key=lambda phase: self.took_s[phase], default="none")


_PHASES: ContextVar[Phases] = ContextVar("phases")


async def follow_phases(request: httpx.Request) -> None:
    """Note the phases of a request in those of its caller."""
    if (phases := _PHASES.get(None)) is not None:
        request.extensions["trace"] = phases.note


@dataclass
class Seen:
    """What honest clients saw.

    Attributes:
        pid: of the server.
        times: to the answers.
        cpu_times: that the server used meanwhile, for whomever; unlike `times`, no other process lengthens them.
        slow: requests over `SLOW_S`, by name and longest phase.
        slowest: name of the slowest one.
        wrong: answers that they should not have got.
        uploaded: submissions.
        found_again: of these, at the end.
    """

    pid: int
    times: list[float] = field(default_factory=list)
    cpu_times: list[float] = field(default_factory=list)
    slow: Counter[str] = field(default_factory=Counter)
    slowest: str = ""
    wrong: Counter[str] = field(default_factory=Counter)
    uploaded: int = 0
    found_again: int = 0

    async def ask(self, name: str, asking: Awaitable[httpx.Response], *, expected: int = 200) -> httpx.Response | None:
        """Note the time of a request, with its longest phase if it was slow, and an answer that was not expected."""
        begun, begun_cpu_s, phases = time.perf_counter(), cpu_s(self.pid), Phases()
        _PHASES.set(phases)
        try:
            answer = await asking
        except httpx.HTTPError as error:
            self.wrong[f"{name}: {type(error).__name__}"] += 1
            return None
        took_s = time.perf_counter() - begun
        if took_s > max(self.times, default=0.0):
            self.slowest = name
        self.times.append(took_s)
        self.cpu_times.append(cpu_s(self.pid) - begun_cpu_s)
        if took_s > SLOW_S:
            self.slow[f"{name}: {phases.longest()}"] += 1
        if answer.status_code != expected:
            self.wrong[f"{name}: {answer.status_code}"] += 1
        return answer


def run_honest(address: str, pid: int, n: int, seconds: float, sender: Connection) -> None:
    """Be the honest teams; send a word when all are there, and at the end what they saw."""
    asyncio.run(_honest(address, pid, n, seconds, sender))


async def _honest(address: str, pid: int, n: int, seconds: float, sender: Connection) -> None:
    seen, clients = Seen(pid=pid), [visitor(address, number, group=3) for number in range(n)]
    names = [f"Honest {os.getpid()} x {number}" for number in range(n)]  # of each part others
    tokens = [await register(client, name) for client, name in zip(clients, names, strict=True)]
    for client, token in zip(clients, tokens, strict=True):
        await prepare_sign_in(client, token)
    sender.send("ready")
    await asyncio.sleep(SETTLE_S)
    seen.times.clear()
    seen.cpu_times.clear()
    seen.slow.clear()
    until = time.monotonic() + seconds
    await asyncio.gather(*(be_honest(seen, *one, until) for one in zip(clients, names, tokens, strict=True)))
    for client in clients:
        await client.aclose()
    times, cpu_times = sorted(seen.times), sorted(seen.cpu_times)
    sender.send(
        {
            "requests": len(times),
            "median_ms": milliseconds(times[len(times) // 2]),
            "p99_ms": milliseconds(times[int(0.99 * len(times))]),
            "max_ms": milliseconds(times[-1]),
            "server_cpu_median_ms": milliseconds(cpu_times[len(times) // 2]),
            "server_cpu_p99_ms": milliseconds(cpu_times[int(0.99 * len(times))]),
            "slowest": seen.slowest,
            "over_1_s": sum(seen.slow.values()),
            "slow": dict(seen.slow),
            "wrong": dict(seen.wrong),
            "uploaded": seen.uploaded,
            "found_again": seen.found_again,
        }
    )


async def register(client: httpx.AsyncClient, name: str) -> str:
    """Register a team and return its captain's token."""
    answer = await client.post(f"{API}/teams", json={"name": name})
    return str(answer.raise_for_status().json()["token"]["secret"])


async def prepare_sign_in(client: httpx.AsyncClient, token: str) -> None:
    """Give the captain a password and sign in with it once, so that the device is known."""
    headers = {"authorization": f"Bearer {token}"}
    me = (await client.get(f"{API}/me", headers=headers)).json()
    team = f"{API}/teams/{me['team']['id']}"
    members = (await client.get(team, headers=headers)).json()["members"]
    await client.patch(f"{team}/members/{members[0]['id']}", headers=headers, json={"password": PASSWORD})
    await sign_in(client, me["team"]["name"])


def sign_in(client: httpx.AsyncClient, team: str) -> Coroutine[Any, Any, httpx.Response]:
    """Sign in as the captain of a team."""
    return client.post("/sign-in/password", data={"team": team, "member": "Captain", "password": PASSWORD})


async def be_honest(seen: Seen, client: httpx.AsyncClient, name: str, token: str, until: float) -> None:
    """Look at a board and at one's submissions, upload one, follow it, and sign in now and then."""
    headers = {"authorization": f"Bearer {token}"}
    await asyncio.sleep(PAUSE_S * random())  # noqa: S311 - no secret
    zipped = {**headers, "content-type": "application/zip"}
    sent = await seen.ask(
        "upload", client.post(f"{API}/submissions", headers=zipped, content=archive(name)), expected=202
    )
    submission = sent.json().get("id") if sent is not None else None
    seen.uploaded += submission is not None
    turn = 0
    while time.monotonic() < until:
        await seen.ask("board", client.get(BOARD))
        await seen.ask("submissions", client.get(f"{API}/submissions", headers=headers))
        await seen.ask("submission", client.get(f"{API}/submissions/{submission}", headers=headers))
        if turn % 20 == 10:
            await seen.ask("sign-in", sign_in(client, name), expected=303)
        turn += 1
        await asyncio.sleep(PAUSE_S)
    listed = await seen.ask("submissions", client.get(f"{API}/submissions", headers=headers))
    found = [one["id"] for one in listed.json().get("items", ())] if listed is not None else []
    seen.found_again += submission in found


def archive(note: str) -> bytes:
    """Return a small submission that no other team has."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as target:
        for path in sorted(EXAMPLE.glob("*.*")):
            target.writestr(f"Track_1/{path.name}", path.read_bytes())
        target.writestr("Track_1/notes.txt", note)
    return content.getvalue()


def run_hostile(address: str, n: int, seconds: float) -> None:
    """Be the hostile clients."""
    asyncio.run(_hostile(address, n, seconds))


async def _hostile(address: str, n: int, seconds: float) -> None:
    makers = [visitor(address, number, group=2) for number in range(min(n, N_ADDRESSES))]
    tokens = [await register(client, f"Self made {number}") for number, client in enumerate(makers)]
    kinds: tuple[Callable[[httpx.AsyncClient, str], Awaitable[object]], ...] = (
        guess_password, load_pages, load_pages, ask_with_token, hold_stream, send_nonsense,
    )  # fmt: skip
    clients = [visitor(address, number % N_ADDRESSES, group=2) for number in range(n)]
    until = time.monotonic() + seconds
    await asyncio.gather(
        *(
            repeat(kinds[number % len(kinds)], client, tokens[number % len(tokens)], until)
            for number, client in enumerate(clients)
        )
    )


async def repeat(
    attack: Callable[[httpx.AsyncClient, str], Awaitable[object]], client: httpx.AsyncClient, token: str, until: float
) -> None:
    """Attack without a pause, whatever the answers are."""
    while time.monotonic() < until:
        try:
            await asyncio.wait_for(attack(client, token), max(0.1, until - time.monotonic()))
        except (httpx.HTTPError, OSError, TimeoutError):
            await asyncio.sleep(0.05)


async def guess_password(client: httpx.AsyncClient, _: str) -> None:
    """Guess the password of an honest team's captain."""
    await client.post("/sign-in/password", data={"team": "Honest", "member": "Captain", "password": "guess" * 3})


async def load_pages(client: httpx.AsyncClient, _: str) -> None:
    """Load what costs most without an account."""
    for path in ("/", BOARD, f"{BOARD}/rules", f"{API}/leaderboards/track_1", "/nothing"):
        await client.get(path)


async def ask_with_token(client: httpx.AsyncClient, token: str) -> None:
    """Ask with the token of a team that was made for this."""
    headers = {"authorization": f"Bearer {token}"}
    for path in (f"{API}/submissions", f"{API}/me", f"{API}/submissions?limit=100"):
        await client.get(path, headers=headers)
    await client.post(
        f"{API}/submissions", headers={**headers, "content-type": "application/zip"}, content=b"x" * 100_000
    )


async def hold_stream(client: httpx.AsyncClient, token: str) -> None:
    """Open event streams of an own submission, and hold them."""
    headers = {"authorization": f"Bearer {token}"}
    sent = await client.post(f"{API}/submissions", headers={**headers, **ZIP}, content=archive(token))
    if sent.is_success:
        async with client.stream("GET", f"{API}/submissions/{sent.json()['id']}/events", headers=headers) as stream:
            async for _ in stream.aiter_lines():
                continue


async def send_nonsense(client: httpx.AsyncClient, _: str) -> None:
    """Send what is no request, slowly."""
    reader, writer = await asyncio.open_connection(client.base_url.host, client.base_url.port)
    for piece in (
        b"GET / HT",
        b"TP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-",
        b"Encoding: chunked\r\n\r\n\0\0",
    ):
        writer.write(piece)
        await writer.drain()
        await asyncio.sleep(0.2)
    await reader.read(1000)
    writer.close()


def milliseconds(seconds: float) -> float:
    """Return a time as it is printed."""
    return round(1000 * seconds, 1)


if __name__ == "__main__":
    sys.exit(main())
